"""Footprints of an apartment's solids as oriented rectangles: the obstacles of a robot."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import lru_cache

import numpy as np

from perdure.home.sim.apartments.piece import Apartment, Articulation, Piece, Pose, Solid
from perdure.home.sim.arrays import FloatArray

AJAR = 0.01
"""A drawer that is open by less in [m] does not stand out of its piece."""
CLIMB, REACH_UP = 0.05, 1.5
"""A solid is in the way when it reaches between these heights in [m] (M3's navigation mesh: climb 0.05, agent 1.5)."""


def footprints(
    piece: Piece, opened: Mapping[str, float] | None = None, low: float = CLIMB, high: float = REACH_UP
) -> FloatArray:
    """Return footprints of one piece's colliding solids, its drawers and doors at the positions `opened` by link name.

    Solids that end below `low` or begin above `high` in [m] are left out. Rectangles (x, y, half x, half y, yaw); those
    inside another of the same piece are left out. Shape (n, 5).
    """
    static = _shadows(piece.pose, piece.solids, low, high)
    moving = [_moved(piece, moving, (opened or {}).get(moving.link, 0.0), low, high) for moving in piece.articulations]
    return _without_hidden(np.concatenate([static, *moving]))


def apartment_footprints(
    apartment: Apartment, opened: Mapping[str, float] | None = None, low: float = CLIMB
) -> FloatArray:
    """Return footprints of all walls and pieces of an apartment, as `footprints`. Shape (n, 5)."""
    parts = [footprints(piece, opened, low) for piece in (*apartment.walls, *apartment.pieces)]
    return np.concatenate(parts)


@lru_cache(maxsize=128)
def static_footprints(apartment: Apartment) -> FloatArray:
    """Return read-only footprints of walls and of the static parts of pieces, as `footprints`. Shape (n, 5)."""
    parts = [
        _without_hidden(_shadows(p.pose, p.solids, CLIMB, REACH_UP)) for p in (*apartment.walls, *apartment.pieces)
    ]
    together = np.concatenate(parts)
    together.flags.writeable = False
    return together


def moving_footprints(apartment: Apartment, positions: FloatArray) -> FloatArray:
    """Return footprints of drawers and doors that are open by at least 1 cm; closed ones are within their piece.

    `positions` are in the order of the apartment's articulations, shape (links,). Shape (n, 5).
    """
    parts = [np.zeros((0, 5))]
    for moving, q in zip(apartment.articulations, positions.tolist(), strict=True):
        if abs(q) > AJAR or moving.kind == "hinge":
            parts.append(_moved_once(apartment, moving.link, q))
    return np.concatenate(parts)


@lru_cache(maxsize=8192)
def _moved_once(apartment: Apartment, link: str, q: float) -> FloatArray:
    return _moved(apartment.piece_of(link), apartment.articulation(link), q, CLIMB, REACH_UP)


def _shadows(pose: Pose, solids: Iterable[Solid], low: float, high: float, lift: float = 0.0) -> FloatArray:
    rows = [
        (s.center[0], s.center[1], s.half[0], s.half[1], pose.yaw)
        for s in solids
        if s.role != "look" and s.center[2] + s.half[2] + lift > low and s.center[2] - s.half[2] + lift < high
    ]
    return pose.to_room(np.array(rows, dtype=np.float64).reshape(-1, 5))


def _moved(piece: Piece, moving: Articulation, q: float, low: float, high: float) -> FloatArray:
    origin = moving.to_piece(np.zeros(3), q)
    turn = q * moving.axis[2] if moving.kind == "hinge" else 0.0
    x, y = piece.pose.to_room(origin[:2])
    return _shadows(Pose(float(x), float(y), piece.pose.yaw + turn), moving.solids, low, high, float(origin[2]))


def _without_hidden(rectangles: FloatArray) -> FloatArray:
    """Drop rectangles that lie inside another one with the same heading."""
    keep = np.ones(len(rectangles), dtype=bool)
    order = np.argsort(-rectangles[:, 2] * rectangles[:, 3], kind="stable")
    for rank, small in enumerate(order):
        for big in order[:rank]:
            if keep[big] and rectangles[big, 4] == rectangles[small, 4] and _holds(rectangles[big], rectangles[small]):
                keep[small] = False
                break
    return rectangles[keep]


def _holds(big: FloatArray, small: FloatArray) -> bool:
    cos, sin = np.cos(big[4]), np.sin(big[4])
    dx, dy = small[0] - big[0], small[1] - big[1]
    out_x = abs(cos * dx + sin * dy) + small[2] - big[2]
    out_y = abs(cos * dy - sin * dx) + small[3] - big[3]
    return bool(max(out_x, out_y) <= 1e-9)
