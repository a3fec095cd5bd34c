"""Where the robot stands when a skill begins: cells of the free space, noise, and facing what the skill is about."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from perdure.home.errors import HomeError
from perdure.home.sim.apartments import Apartment, FreeSpace, Pose, free_space

FloatArray = NDArray[np.float64]

NEAR = 2.0
"""How far from what it is about a pick or place begins at most, in [m] (M3)."""
IN_FRONT = 0.5
"""Cosine of the angle within which a container's inside is approached (OURS)."""
PLACE_SPREAD, PLACE_FARTHEST = 0.1, 0.2
"""Noise of the base's place per axis in [m]: standard deviation and cut (M3)."""
TURN_SPREAD, TURN_FARTHEST = 0.25, 0.5
"""Noise of its heading in [rad] (M3)."""

Rectangle = tuple[tuple[float, float], float]
"""x from, to; half width in y."""


def closed_space(apartment: Apartment) -> FreeSpace:
    """The free space with all drawers and doors closed (M3's navigation mesh is a fixed one, too).

    Whether the robot meets one that is open is seen when it has been put there.
    """
    return free_space(apartment, {})


def stand_near(
    apartment: Apartment,
    point: tuple[float, float, float],
    rng: np.random.Generator,
    front: tuple[float, float] | None = None,
) -> Pose:
    """A cell within 2.0 m of a point, with noise, facing the point.

    Args:
        apartment: Where.
        point: What to face.
        rng: What to draw from.
        front: For a point inside a container: which way it is open. The cell lies within 60 degrees of it (OURS: here,
            unlike in a kitchen unit, the robot could stand beside the fridge, where navigation never leaves it).
    """
    return _draw(_cells_near(apartment, point[:2], front), point, rng)


@lru_cache(maxsize=4096)
def _cells_near(apartment: Apartment, point: tuple[float, float], front: tuple[float, float] | None) -> FloatArray:
    """Middles of the cells of the largest island within 2.0 m of a point, in front of it. Shape (m, 2)."""
    space = closed_space(apartment)
    away = np.hypot(*(space.centers - point).T)
    inside = (space.island == 0) & (away <= NEAR)
    if front is not None:
        inside &= (space.centers - point) @ np.asarray(front) >= IN_FRONT * away
    cells: FloatArray = space.centers[inside]
    cells.flags.writeable = False
    return cells


def stand_in(
    apartment: Apartment,
    frame: Pose,
    rectangles: tuple[Rectangle, ...],
    point: tuple[float, float, float],
    rng: np.random.Generator,
) -> Pose:
    """A cell in a rectangle before a piece of furniture, with noise, facing a point.

    Args:
        apartment: Where.
        frame: The rectangle's frame: x away from the piece, y to its left.
        rectangles: The first one that has a free cell is used.
        point: What to face.
        rng: What to draw from.
    """
    space = closed_space(apartment)
    local = frame.to_local(space.centers)
    for (low, high), half in rectangles:
        inside = (local[:, 0] >= low) & (local[:, 0] <= high) & (np.abs(local[:, 1]) <= half) & (space.island == 0)
        if inside.any():
            return _draw(space.centers[inside], point, rng)
    raise HomeError(f"{apartment.name}: the robot can stand nowhere before {frame}")


def stand_anywhere(apartment: Apartment, opened: Mapping[str, float], rng: np.random.Generator) -> Pose:
    """A cell of the largest island, any heading."""
    space = free_space(apartment, opened)
    x, y = _cell(space.centers[space.island == 0], rng)
    return Pose(x, y, 2.0 * np.pi * float(rng.random()))


def _draw(cells: FloatArray, point: tuple[float, float, float], rng: np.random.Generator) -> Pose:
    x, y = _cell(cells, rng)
    dx, dy = np.clip(rng.normal(0.0, PLACE_SPREAD, 2), -PLACE_FARTHEST, PLACE_FARTHEST)
    turn = float(np.clip(rng.normal(0.0, TURN_SPREAD), -TURN_FARTHEST, TURN_FARTHEST))
    x, y = x + float(dx), y + float(dy)
    return Pose(x, y, float(np.arctan2(point[1] - y, point[0] - x)) + turn)


def _cell(cells: FloatArray, rng: np.random.Generator) -> tuple[float, float]:
    if not len(cells):
        raise HomeError("the robot can stand nowhere: no free cell is allowed")
    x, y = cells[int(rng.integers(len(cells)))]
    return float(x), float(y)
