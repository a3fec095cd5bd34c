"""Furniture, which is data, and the walls of a room.

`data/furniture.json` holds every kind of piece in its own frame, with a note on its sizes and their source, and the
colors. Outer sizes of `table_01`, `chair_01` and `sofa` are those of ReplicaCAD's objects of that name (1.40 x 0.85 m
and 0.74 m high; 0.80 x 0.71 x 0.76; 2.14 x 0.96 x 0.80, as measured by users of the data set). What a note calls "our
choice", and the regions of all receptacles, was chosen here: `docs/home/benchmark.md` lists it.

Damping of drawers and doors. M3 (`sim.py`) gives every joint of furniture a Bullet velocity motor with target 0, gain
0.3 and 120 steps per second: each step leaves 0.7 of the speed, so speed decays as exp(-t / tau) with
tau = -1 / (120 ln 0.7) = 0.0234 s. As a viscous joint that is damping = inertia / tau, with a drawer's mass, or the
inertia of a slab of 8 kg and 0.712 m whose middle is 0.33 m from the hinge. The motor's impulse limit (1.0 N s per
step) and the URDF's own damping and dry friction (0.01 each) are left out: they are far larger or far smaller than
anything the viscous term does at the speeds of a hand.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from perdure.home.sim.pieces import Articulation, Piece, Pose, Receptacle, Solid, Zone
from perdure.schema import Record, read_json


class Furniture(Record, frozen=True):
    """A kind of piece. Its receptacles carry the kind in place of the piece's name."""

    note: str
    solids: tuple[Solid, ...]
    receptacles: tuple[Receptacle, ...] = ()
    articulations: tuple[Articulation, ...] = ()
    zones: tuple[Zone, ...] = ()


class _Data(Record, frozen=True):
    pieces: dict[str, Furniture]
    colors: dict[str, tuple[float, float, float, float]]


_DATA: _Data = read_json((Path(__file__).parents[1] / "data" / "furniture.json").read_bytes(), _Data)
FURNITURE = _DATA.pieces
"""By kind."""
COLORS = _DATA.colors
"""Red, green, blue and alpha in [0, 1], by name."""


def make_piece(kind: str, name: str, pose: Pose) -> Piece:
    """Return a piece of furniture that stands at a pose."""
    made = FURNITURE[kind]
    receptacles = tuple(replace(each, piece=name) for each in made.receptacles)
    return Piece(name, kind, pose, made.solids, receptacles, made.articulations, made.zones)


WALL_HEIGHT = 2.5
"""Height of the walls in [m] (our choice)."""
WALL_THICKNESS = 0.1
"""Thickness of the walls in [m] (our choice)."""

Corner = tuple[float, float]


def _slab(name: str, x: float, y: float, yaw: float, half_length: float, half_width: float) -> Piece:
    solid = Solid("slab", (0.0, 0.0, WALL_HEIGHT / 2.0), (half_length, half_width, WALL_HEIGHT / 2.0), "wall")
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
        low = -WALL_THICKNESS if _is_convex(before, start, end) else 0.0
        high = length + (WALL_THICKNESS if _is_convex(start, end, after) else 0.0)
        middle, out = 0.5 * (low + high), 0.5 * WALL_THICKNESS
        x = start[0] + middle * along[0] + out * along[1]
        y = start[1] + middle * along[1] - out * along[0]
        walls.append(_slab(f"wall_{k}", x, y, math.atan2(along[1], along[0]), 0.5 * (high - low), out))
    for k, (x0, y0, x1, y1) in enumerate(partitions):
        half_x, half_y = 0.5 * (x1 - x0), 0.5 * (y1 - y0)
        walls.append(_slab(f"partition_{k}", 0.5 * (x0 + x1), 0.5 * (y0 + y1), 0.0, half_x, half_y))
    return tuple(walls)
