"""What the four starts share in which a handle is to be held."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from perdure.home.benchmark.episodes import Episode
from perdure.home.benchmark.tasks import SkillName
from perdure.home.errors import HomeError
from perdure.home.sim.apartments import Pose
from perdure.home.sim.objects import Placement
from perdure.home.sim.world import SkillGoal
from perdure.home.skills.skill_goals import front
from perdure.home.skills.starts.arm import draw_arm
from perdure.home.skills.starts.containers import handle, link_number
from perdure.home.skills.starts.stand import Rectangle, stand_in
from perdure.home.skills.starts.start import Start


def container_of(episode: Episode, target: int) -> str:
    """The drawer or door a target is in; HomeError when it lies in the open."""
    link = episode.container(target)
    if link is None:
        raise HomeError(f"target {target} of {episode.name} lies in the open: there is nothing to open or close")
    return link


def start_at_handle(
    episode: Episode,
    target: int,
    skill: SkillName,
    before: tuple[Pose, tuple[Rectangle, ...]],
    opened: Mapping[str, float],
    rng: np.random.Generator,
) -> Start:
    """A start in a rectangle, facing the handle.

    Args:
        episode: The episode.
        target: Whose container is opened or closed.
        skill: By which skill.
        before: The frame and the rectangles in it where the robot may stand, see `stand_in`.
        opened: How far drawers and doors are open.
        rng: What to draw from.
    """
    apartment, link = episode.apartment(), container_of(episode, target)
    point = handle(apartment, link, opened.get(link, 0.0))
    skill_goal = SkillGoal(
        0,
        episode.goals[target].position,
        link_number(apartment, link),
        skill,
        point,
        front=front(episode, target, skill),
    )
    closing = skill in ("close_drawer", "close_fridge")
    return Start(
        base=stand_in(apartment, *before, point, rng),
        arm=draw_arm(rng),
        skill_goal=skill_goal,
        opened=opened,
        moved=at_goal(episode, target) if closing else {},
    )


def at_goal(episode: Episode, target: int) -> dict[int, Placement]:
    """The target where it belongs: by the time its container is closed it has been placed."""
    return {0: episode.goals[target]}
