"""Walls of a room: one slab outside every edge of its floor, and the partitions inside."""

from __future__ import annotations

import math
from collections.abc import Sequence

from perdure.home.sim.apartments.piece import Piece, Pose, Solid

HEIGHT = 2.5
"""Height of the walls in [m] (OURS)."""
THICKNESS = 0.1
"""Thickness of the walls in [m] (OURS)."""

Corner = tuple[float, float]


def _slab(name: str, x: float, y: float, yaw: float, half_length: float, half_width: float) -> Piece:
    solid = Solid("slab", (0.0, 0.0, HEIGHT / 2.0), (half_length, half_width, HEIGHT / 2.0), "wall")
    return Piece(name, "wall", Pose(x, y, yaw), (solid,))


def _is_convex(before: Corner, corner: Corner, after: Corner) -> bool:
    turn = (corner[0] - before[0]) * (after[1] - corner[1]) - (corner[1] - before[1]) * (after[0] - corner[0])
    return turn > 0.0


def room_walls(
    room: Sequence[Corner], partitions: Sequence[tuple[float, float, float, float]] = ()
) -> tuple[Piece, ...]:
    """Return walls around a floor whose corners run counter-clockwise, and axis-aligned partitions (x0, y0, x1, y1).

    A wall lies outside its edge. At a corner that juts out it is longer by its thickness, so that no gap stays open.
    """
    count = len(room)
    walls = []
    for k in range(count):
        before, start, end, after = (room[(k + shift) % count] for shift in (-1, 0, 1, 2))
        length = math.hypot(end[0] - start[0], end[1] - start[1])
        along = ((end[0] - start[0]) / length, (end[1] - start[1]) / length)
        low = -THICKNESS if _is_convex(before, start, end) else 0.0
        high = length + (THICKNESS if _is_convex(start, end, after) else 0.0)
        middle, out = 0.5 * (low + high), 0.5 * THICKNESS
        x = start[0] + middle * along[0] + out * along[1]
        y = start[1] + middle * along[1] - out * along[0]
        walls.append(_slab(f"wall_{k}", x, y, math.atan2(along[1], along[0]), 0.5 * (high - low), out))
    for k, (x0, y0, x1, y1) in enumerate(partitions):
        half_x, half_y = 0.5 * (x1 - x0), 0.5 * (y1 - y0)
        walls.append(_slab(f"partition_{k}", 0.5 * (x0 + x1), 0.5 * (y0 + y1), 0.0, half_x, half_y))
    return tuple(walls)
