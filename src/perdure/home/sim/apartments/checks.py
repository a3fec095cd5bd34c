"""Checks of an apartment: pieces do not overlap, doors and drawers have space, receptacles are within reach.

`why_not` names the first reason why an apartment is refused. It is used when micro variations are drawn; the tests look
at the apartments with independent means.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from perdure.home.sim.apartments import plane
from perdure.home.sim.apartments.footprint import CLIMB, REACH_UP, footprints
from perdure.home.sim.apartments.free_space import FreeSpace, free_space
from perdure.home.sim.apartments.piece import Apartment, Piece, Receptacle, Zone
from perdure.home.sim.arrays import FloatArray, IntArray

GAP = 0.02
"""Smallest gap between two pieces in [m]."""
REACH = 0.95
"""Largest horizontal distance in [m] from a point where an object may lie to a place where the robot can stand."""
SMALLEST_ISLAND = 10.0
"""Smallest area in [m^2] of the largest island."""
LARGEST_LEFTOVER = 0.5
"""Largest area in [m^2] of the other islands together."""


def why_not(apartment: Apartment) -> str | None:
    """Return the first reason why an apartment cannot be used, None when it can."""
    return _crowded(apartment) or _blocked(apartment) or _unreachable(apartment)


def _crowded(apartment: Apartment) -> str | None:
    """Return which two pieces are too close; furniture may touch a wall but not reach into it."""
    bodies = (*apartment.walls, *apartment.pieces)
    shapes, owner = _stacked(bodies, low=-1.0, high=10.0)
    wall = np.array([body.kind == "wall" for body in bodies])[owner]
    one_wall, both_walls = wall[:, None] | wall[None, :], wall[:, None] & wall[None, :]
    close = np.where(one_wall, plane.overlap(shapes, shapes), plane.overlap(shapes, shapes, GAP))
    pairs = np.argwhere(close & ~both_walls & (owner[:, None] != owner[None, :]))
    if len(pairs) == 0:
        return None
    return f"{bodies[owner[pairs[0, 0]]].name} is too close to {bodies[owner[pairs[0, 1]]].name}"


def _blocked(apartment: Apartment) -> str | None:
    """Return a piece or wall in another piece's zone."""
    bodies = (*apartment.walls, *apartment.pieces)
    shapes, owner = _stacked(bodies)
    zones = [(body, _zone_rectangle(piece, zone)) for body, piece in enumerate(bodies) for zone in piece.zones]
    keeper = np.array([body for body, _ in zones])
    inside = plane.overlap(np.concatenate([area for _, area in zones]), shapes)
    pairs = np.argwhere(inside & (keeper[:, None] != owner[None, :]))
    if len(pairs) == 0:
        return None
    return f"{bodies[owner[pairs[0, 1]]].name} stands in the zone of {bodies[keeper[pairs[0, 0]]].name}"


def _stacked(bodies: Sequence[Piece], low: float = CLIMB, high: float = REACH_UP) -> tuple[FloatArray, IntArray]:
    """Return the footprints of several bodies in one array, and which body each belongs to."""
    shapes = [footprints(body, low=low, high=high) for body in bodies]
    return np.concatenate(shapes), np.repeat(np.arange(len(bodies)), [len(shape) for shape in shapes])


def _unreachable(apartment: Apartment) -> str | None:
    """Return whether there is too little floor, or which receptacle the robot cannot reach."""
    space = free_space(apartment)
    if not space.free.any() or space.areas[0] < SMALLEST_ISLAND or space.areas[1:].sum() > LARGEST_LEFTOVER:
        return "the floor is not one island of sufficient size"
    for receptacle in apartment.receptacles:
        if farthest_point(apartment, receptacle, space) > REACH:
            return f"{receptacle.unique_name} is out of reach"
    return None


def farthest_point(apartment: Apartment, receptacle: Receptacle, space: FreeSpace) -> float:
    """Return the largest horizontal distance from a point of a receptacle to the largest island, in [m].

    Looked at on a 9 x 9 grid of points. Objects in a drawer are reached from beside the open drawer, so there the
    distance is that of the closed drawer's handle.
    """
    if receptacle.link is not None:
        points = apartment.handle_to_room(receptacle.link)[None, :2]
    else:
        ticks = np.linspace(-1.0, 1.0, 9)
        grid = np.stack(np.meshgrid(ticks, ticks), axis=-1).reshape(-1, 2) * receptacle.half
        points = apartment.surface_to_room(receptacle, grid)[:, :2]
    return float(space.nearest(points)[1].max())


def _zone_rectangle(piece: Piece, zone: Zone) -> FloatArray:
    middle = 0.5 * (np.array(zone.low) + np.array(zone.high))
    half = 0.5 * (np.array(zone.high) - np.array(zone.low))
    x, y = piece.pose.to_room(middle)
    return np.array([[x, y, half[0], half[1], piece.pose.yaw]])
