"""All skills by name, and the goal of a plan's step. `perdure.home.skills` fills the registry."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches
from typing import Any

from perdure.home.benchmark.episodes import Episode
from perdure.home.benchmark.tasks import SkillStep
from perdure.home.errors import HomeError
from perdure.home.sim.world import Simulator, SkillGoal
from perdure.home.skills.skill import Skill
from perdure.home.skills.starts import open_links

SKILLS: dict[str, type[Skill]] = {}
"""All skills by name."""


def get_skill(name: str, **options: Any) -> Skill:
    """Return a skill by its name in `SKILLS`, with options such as `delta` of place; HomeError for an unknown name."""
    if name not in SKILLS:
        raise HomeError(f"no skill is named {name!r}; {choices(name, SKILLS)}")
    return SKILLS[name](**options)


def learned_skills() -> tuple[str, ...]:
    """Return the names of the skills that have a recipe, and so an environment."""
    return tuple(name for name, kind in SKILLS.items() if kind.recipe is not None)


def choices(wrong: str, names: Iterable[str]) -> str:
    """Return the part of a message that lists valid names, the nearest to the wrong one apart."""
    names = list(names)
    nearest = get_close_matches(wrong, names, n=1)
    return f"there are {', '.join(names)}" + (f"; did you mean {nearest[0]}?" if nearest else "")


def make_skill_goal(episode: Episode, step: SkillStep, lane: Simulator) -> SkillGoal:
    """Return the goal of a plan's step in the current state of a lane.

    The episode's targets must be the first objects of the scene.
    """
    return get_skill(step.skill).skill_goal(episode, step.target, open_links(lane), step.toward)
