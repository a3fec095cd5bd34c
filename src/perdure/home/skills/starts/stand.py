"""Where the robot stands when a skill begins: a free cell, with noise, facing what the skill acts on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from perdure.home.errors import HomeError
from perdure.home.sim.apartments import Apartment, FreeSpace, Pose, free_space
from perdure.home.sim.arrays import BoolArray, FloatArray

NEAR = 2.0
"""Largest distance from the object or goal at which pick or place begins in [m] (M3)."""
IN_FRONT = 0.5
"""Cosine of the largest angle from a container's open side at which the robot begins (OURS)."""
POSITION_NOISE, POSITION_CLIP = 0.1, 0.2
"""Noise of the base position per axis in [m]: standard deviation and clip (M3)."""
HEADING_NOISE, HEADING_CLIP = 0.25, 0.5
"""Noise of the heading in [rad]: standard deviation and clip (M3)."""


@dataclass(frozen=True)
class Rectangle:
    """A rectangle on the floor in front of furniture: x away from the furniture, y to its left, in [m]."""

    x: tuple[float, float]
    half_width: float

    def contains(self, local: FloatArray) -> BoolArray:
        """Return which points of the rectangle's frame are inside. Shape (n, 2) -> (n,)."""
        x, y = local[:, 0], np.abs(local[:, 1])
        return (x >= self.x[0]) & (x <= self.x[1]) & (y <= self.half_width)


def closed_space(apartment: Apartment) -> FreeSpace:
    """Return the free space with all drawers and doors closed (M3's navigation mesh is fixed, too).

    A robot that touches an open one is found by the contact check of `begin`.
    """
    return free_space(apartment, {})


def stand_near(
    apartment: Apartment,
    point: tuple[float, float, float],
    rng: np.random.Generator,
    front: tuple[float, float] | None = None,
) -> Pose:
    """Draw a cell within 2.0 m of a point, with noise, facing the point.

    `front` is the direction of a container's open side. The cell is within 60 degrees of it (OURS: beside our fridge
    there is floor, which navigation never ends on).
    """
    return _draw(_cells_near(apartment, point[:2], front), point, rng)


@lru_cache(maxsize=4096)
def _cells_near(apartment: Apartment, point: tuple[float, float], front: tuple[float, float] | None) -> FloatArray:
    """Return the centers of allowed cells. Shape (m, 2)."""
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
    """Draw a cell of the first of some rectangles that has a free one, with noise, facing a point.

    The rectangles are in `frame`. HomeError if none contains a free cell.
    """
    space = closed_space(apartment)
    local = frame.to_local(space.centers)
    for rectangle in rectangles:
        inside = rectangle.contains(local) & (space.island == 0)
        if inside.any():
            return _draw(space.centers[inside], point, rng)
    raise HomeError(f"{apartment.name}: no free cell in front of the furniture at {frame}")


def stand_anywhere(apartment: Apartment, opened: Mapping[str, float], rng: np.random.Generator) -> Pose:
    """Draw a cell of the largest island and a heading, both uniformly."""
    space = free_space(apartment, opened)
    x, y = _cell(space.centers[space.island == 0], rng)
    return Pose(x, y, 2.0 * np.pi * float(rng.random()))


def _draw(cells: FloatArray, point: tuple[float, float, float], rng: np.random.Generator) -> Pose:
    x, y = _cell(cells, rng)
    dx, dy = np.clip(rng.normal(0.0, POSITION_NOISE, 2), -POSITION_CLIP, POSITION_CLIP)
    turn = float(np.clip(rng.normal(0.0, HEADING_NOISE), -HEADING_CLIP, HEADING_CLIP))
    x, y = x + float(dx), y + float(dy)
    return Pose(x, y, float(np.arctan2(point[1] - y, point[0] - x)) + turn)


def _cell(cells: FloatArray, rng: np.random.Generator) -> tuple[float, float]:
    if not len(cells):
        raise HomeError("the robot has no free cell to begin in")
    x, y = cells[int(rng.integers(len(cells)))]
    return float(x), float(y)
