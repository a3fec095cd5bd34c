"""The environments' names in Gymnasium's registry."""

from __future__ import annotations

import gymnasium

from perdure.envs.suites import VectorSuite
from perdure.home.benchmark.tasks import TASKS, get_task
from perdure.home.skills import get_skill
from perdure.home.skills.starts import STARTS

SUITE = VectorSuite("Home", "perdure.home.skills.gym", "perdure/Home")
"""The suite of these environments, which `pyproject.toml` names as an entry point."""


def env_id(skill: str) -> str:
    """Such as `perdure/HomeOpenDrawer-v0` for `open_drawer`."""
    return f"perdure/Home{''.join(word.capitalize() for word in skill.split('_'))}-v0"


def default_task(skill: str) -> str:
    """The first task that uses a skill."""
    return next(name for name in TASKS if any(step.skill == skill for step in get_task(name).skills))


def register() -> None:
    """Registers one environment per skill, by entry-point strings; doing so again changes nothing."""
    for skill in STARTS:
        if env_id(skill) in gymnasium.registry:
            continue
        gymnasium.register(
            env_id(skill),
            entry_point="perdure.home.skills.gym.single:HomeSkillEnv",
            vector_entry_point="perdure.home.skills.gym.vector:HomeSkillVectorEnv",
            max_episode_steps=get_skill(skill).limit,
            kwargs={"skill": skill, "task": default_task(skill)},
        )
