"""All skills by name, and the goal of a plan's step. `perdure.home.skills` fills the registry."""

from __future__ import annotations

from typing import Any

from perdure.errors import lookup
from perdure.home.sim.sensors import SkillGoal
from perdure.home.sim.simulator import Simulator
from perdure.home.skills.skill import Skill
from perdure.home.skills.starts import open_links
from perdure.home.tasks.episodes import Episode
from perdure.home.tasks.tasks import SkillStep

SKILLS: dict[str, type[Skill]] = {}
"""All skills by name."""
PREFIX = "perdure/Home"


def env_id(skill: str) -> str:
    """Return the id of a skill's environment, such as `perdure/HomeOpenDrawer-v0` for `open_drawer`."""
    return f"{PREFIX}{''.join(word.capitalize() for word in skill.split('_'))}-v0"


def get_skill(name: str, **options: Any) -> Skill:
    """Return a skill by its name in `SKILLS`, with options such as `delta` of place; refuse an unknown name."""
    return lookup(SKILLS, name, "skill")(**options)


def learned_skills() -> tuple[str, ...]:
    """Return the names of the skills that have a recipe, and so an environment."""
    return tuple(name for name, kind in SKILLS.items() if kind.recipe is not None)


def make_skill_goal(episode: Episode, step: SkillStep, lane: Simulator) -> SkillGoal:
    """Return the goal of a plan's step in the current state of a lane.

    The episode's targets must be the first objects of the scene.
    """
    return get_skill(step.skill).skill_goal(episode, step.target, open_links(lane), step.toward)
