"""Where a robot may stand for a skill: M3's region goals of navigation, cells of the free space.

A region is given in a frame on the floor: x away from the piece of furniture, y to its left (M3,
`configs/rearrange/tasks/nav_v1*.yaml`, `sub_tasks/nav*.py`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from perdure.home.benchmark.tasks import SkillName
from perdure.home.errors import HomeError
from perdure.home.sim.apartments import Apartment, FreeSpace, Pose, free_space

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

OPEN_RADIUS, GROW_BY, GROW_TO = 0.8, 0.1, 2.0
"""On open receptacles: within 0.8 m of the target, more in steps of 0.1 m while there is no such cell, up to 2.0 m."""
DOOR_KEPT = 0.4
"""How far in front of the fridge's handle the robot stays when it picks from or places into the fridge."""


@dataclass(frozen=True)
class Box:
    """A rectangle in a frame on the floor."""

    x: tuple[float, float]
    y: float
    """Half width."""


IN_FRONT: dict[str, Box] = {
    "open_drawer": Box((0.80, 0.95), 0.35),
    "close_drawer": Box((0.30, 0.45), 0.35),
    "drawer": Box((0.30, 0.45), 0.35),
    "open_fridge": Box((0.9, 1.8), 0.5),
    "close_fridge": Box((0.9, 1.8), 0.5),
    "fridge": Box((1.0, 1.8), 0.5),
}
"""Regions by skill or, for pick and place, by container: in the handle's frame for drawers, in the fridge's else."""


@dataclass(frozen=True)
class Aim:
    """What a skill is about, as navigation sees it."""

    skill: SkillName
    point: tuple[float, float, float]
    """What the robot should face: an object, a goal or a handle, in the room in [m]."""
    link: str | None = None
    """The drawer or door that is opened or closed, or that contains the object or goal."""


def region(apartment: Apartment, opened: Mapping[str, float], aim: Aim) -> tuple[FreeSpace, IntArray]:
    """The cells a robot may stand on for a skill.

    Args:
        apartment: Where.
        opened: How far drawers and doors are open now, by link name.
        aim: What for.

    Returns:
        The free space, and indices into its `centers`, never empty: all on the largest island.
    """
    space = free_space(apartment, opened)
    centers, main = space.centers, space.island == 0
    if aim.link is None:
        away = np.hypot(*(centers - np.asarray(aim.point)[:2]).T)
        for radius in np.arange(OPEN_RADIUS, GROW_TO + 1e-9, GROW_BY):
            inside = main & (away <= radius)
            if inside.any():
                return space, np.nonzero(inside)[0]
        raise HomeError(f"nobody can stand within {GROW_TO} m of {np.round(aim.point, 2).tolist()}")
    local = _frame(apartment, opened, aim).to_local(centers)
    box = IN_FRONT[aim.skill if aim.skill in IN_FRONT else _container(apartment, aim.link)]
    inside = main & (local[:, 0] >= box.x[0]) & (local[:, 0] <= box.x[1]) & (np.abs(local[:, 1]) <= box.y)
    if inside.any():
        return space, np.nonzero(inside)[0]
    # No such cell (M3 would drop the episode): the nearest ones to the rectangle.
    outside = np.maximum(np.maximum(box.x[0] - local[:, 0], local[:, 0] - box.x[1]), 0.0)
    miss = np.where(main, outside + np.maximum(np.abs(local[:, 1]) - box.y, 0.0), np.inf)
    return space, np.nonzero(miss <= miss.min() + 1e-9)[0]


def _container(apartment: Apartment, link: str) -> str:
    return "drawer" if apartment.articulation(link).kind == "slide" else "fridge"


def _frame(apartment: Apartment, opened: Mapping[str, float], aim: Aim) -> Pose:
    assert aim.link is not None
    piece = apartment.piece_of(aim.link).pose
    if _container(apartment, aim.link) == "fridge":
        return piece
    handle = apartment.handle_to_room(aim.link, opened.get(aim.link, 0.0))
    return Pose(float(handle[0]), float(handle[1]), piece.yaw)
