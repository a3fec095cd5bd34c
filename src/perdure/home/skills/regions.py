"""Where navigation should end: the cells from which the next skill can begin.

The regions are those of M3 (`configs/rearrange/tasks/nav_v1*.yaml`, `sub_tasks/nav*.py`), with one difference (OURS):
for pick and place in the fridge M3 also keeps only cells at least 0.4 m behind the handle of the open door. So our
robot may stop in front of the door's edge.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from perdure.home.errors import HomeError
from perdure.home.sim.apartments import Apartment, FreeSpace, free_space
from perdure.home.sim.arrays import IntArray
from perdure.home.skills.starts import Rectangle, front_frame, is_drawer

OPEN_RADIUS, GROW_BY, GROW_TO = 0.8, 0.1, 2.0
"""In the open: radius around the point in [m], and the step and limit by which it grows until it contains a cell."""
BEFORE_DRAWER, BEFORE_FRIDGE = Rectangle((0.30, 0.45), 0.35), Rectangle((1.0, 1.8), 0.5)
"""Regions for reaching into an open container, in the frame of `front_frame`."""


@dataclass(frozen=True)
class Aim:
    """What a skill acts on, as navigation needs it."""

    point: tuple[float, float, float]
    """The object, goal or handle that the robot should face, in the room in [m]."""
    link: str | None = None
    """The drawer or door that the skill moves, or that contains the object or goal."""
    rectangle: Rectangle | None = None
    """The region in front of `link`; the one for reaching into it when None."""


def region(apartment: Apartment, opened: Mapping[str, float], aim: Aim) -> tuple[FreeSpace, IntArray]:
    """Return the cells from which a skill can begin, with drawers and doors at the positions `opened` by link name.

    The free space, and indices into its `centers`, never empty: all on the largest island. HomeError if there is no
    cell within 2 m of a point in the open.
    """
    space = free_space(apartment, opened)
    centers, main = space.centers, space.island == 0
    if aim.link is None:
        away = np.hypot(*(centers - np.asarray(aim.point)[:2]).T)
        for radius in np.arange(OPEN_RADIUS, GROW_TO + 1e-9, GROW_BY):
            inside = main & (away <= radius)
            if inside.any():
                return space, np.nonzero(inside)[0]
        raise HomeError(f"no free cell within {GROW_TO} m of {np.round(aim.point, 2).tolist()}")
    box = aim.rectangle or (BEFORE_DRAWER if is_drawer(apartment, aim.link) else BEFORE_FRIDGE)
    local = front_frame(apartment, aim.link, opened.get(aim.link, 0.0)).to_local(centers)
    inside = main & box.contains(local)
    if inside.any():
        return space, np.nonzero(inside)[0]
    # M3 would drop such an episode; use the cells nearest to the rectangle.
    outside = np.maximum(np.maximum(box.x[0] - local[:, 0], local[:, 0] - box.x[1]), 0.0)
    miss = np.where(main, outside + np.maximum(np.abs(local[:, 1]) - box.half_width, 0.0), np.inf)
    return space, np.nonzero(miss <= miss.min() + 1e-9)[0]
