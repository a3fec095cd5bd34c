"""The environments' names in Gymnasium's registry."""

from __future__ import annotations

import gymnasium

from perdure.envs.suites import VectorSuite
from perdure.home.benchmark.tasks import TASKS
from perdure.home.errors import HomeError
from perdure.home.skills.gym.options import targets_of
from perdure.home.skills.registry import get_skill, learned_skills

PREFIX = "perdure/Home"
SUITE = VectorSuite("Home", "perdure.home.skills.gym", PREFIX)
"""The suite of these environments, which `pyproject.toml` names as an entry point."""


def env_id(skill: str) -> str:
    """Return an id such as `perdure/HomeOpenDrawer-v0` for `open_drawer`."""
    return f"{PREFIX}{''.join(word.capitalize() for word in skill.split('_'))}-v0"


def check_id(skill: str, registered: str | None) -> None:
    """Raise HomeError if an id that is registered for one skill would make another."""
    if registered not in (None, skill):
        raise HomeError(f"{env_id(registered)} has the skill {registered}, not {skill}: use {env_id(skill)}")


def default_task(skill: str) -> str:
    """Return the first task that uses a skill."""
    return next(name for name, task in TASKS.items() if targets_of(skill, task))


def register() -> None:
    """Register an environment for each learned skill that has none; call it again after adding a skill."""
    for skill in learned_skills():
        if env_id(skill) in gymnasium.registry:
            continue
        gymnasium.register(
            env_id(skill),
            entry_point="perdure.home.skills.gym.single:HomeSkillEnv",
            vector_entry_point="perdure.home.skills.gym.vector:HomeSkillVectorEnv",
            max_episode_steps=get_skill(skill).limit,
            kwargs={"skill": skill, "task": default_task(skill), "registered_skill": skill},
        )
