"""What an apartment is made of: boxes, receptacles, articulations, pieces of furniture, which are data, and walls.

Frames. A piece of furniture has a local frame: x points out of its front, y to its own left, z up, the origin on the
floor. The room frame is x east, y north, z up. Lengths in [m], angles in [rad], masses in [kg].

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

import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np

from perdure.errors import lookup
from perdure.home.sim.arrays import FloatArray, Vec3
from perdure.schema import Record, read_json

INSIDE_MARGIN = 0.1
"""Distance in [m] beside and below a receptacle at which an object still lies in its container."""
Role = Literal["solid", "look", "hull"]
"""solid: collides and is seen; look: is seen only; hull: collides only."""


@dataclass(frozen=True)
class Pose:
    """Where a local frame stands on the floor of the room: position (x, y) in [m] and heading `yaw` in [rad]."""

    x: float
    y: float
    yaw: float

    def to_room(self, local: FloatArray) -> FloatArray:
        """Return room coordinates of local points; only x and y are rotated. Shape (..., 2 or 3)."""
        cos = np.cos(self.yaw)
        sin = np.sin(self.yaw)
        x = local[..., 0]
        y = local[..., 1]
        room = np.array(local, dtype=np.float64)
        room[..., 0] = self.x + cos * x - sin * y
        room[..., 1] = self.y + sin * x + cos * y
        return room

    def to_local(self, room: FloatArray) -> FloatArray:
        """Return local coordinates of room points: the inverse of `to_room`. Shape (..., 2 or 3)."""
        cos = np.cos(self.yaw)
        sin = np.sin(self.yaw)
        x = room[..., 0] - self.x
        y = room[..., 1] - self.y
        local = np.array(room, dtype=np.float64)
        local[..., 0] = cos * x + sin * y
        local[..., 1] = cos * y - sin * x
        return local


@dataclass(frozen=True)
class Solid:
    """One primitive of a piece: a box, or a cylinder or ellipsoid inscribed in that box, aligned with the frame."""

    name: str
    center: Vec3
    half: Vec3
    """Half extents along x, y, z; of a cylinder (radius, radius, half height)."""
    color: str
    """A name in `COLORS`."""
    role: Role = "solid"
    shape: Literal["box", "cylinder", "ellipsoid"] = "box"


@dataclass(frozen=True)
class Zone:
    """A rectangle of floor in a piece's frame, [low, high] along x and y, that no other piece may stand on."""

    low: tuple[float, float]
    high: tuple[float, float]


@dataclass(frozen=True)
class Receptacle:
    """A horizontal surface that can hold objects: where their centers may be drawn, in the frame of its piece."""

    name: str
    """The benchmark's own name, such as `receptacle_aabb_Tbl1_Top1_frl_apartment_table_01`."""
    piece: str
    center: Vec3
    """Middle of the region, on the supporting surface. For a drawer: with the drawer closed."""
    half: tuple[float, float]
    headroom: float = math.inf
    """Free height above the surface."""
    link: str | None = None
    """The articulation it moves with, None when it stands still."""

    @property
    def unique_name(self) -> str:
        """`piece|name`: two chairs carry the same receptacle name, as in the benchmark."""
        return f"{self.piece}|{self.name}"


@dataclass(frozen=True)
class Articulation:
    """A drawer that slides or a door that swings, with the handle the gripper may hold."""

    link: str
    """Name of the moving part as in ReplicaCAD's URDF, such as `drawer2_top`."""
    joint: str
    kind: Literal["slide", "hinge"]
    origin: Vec3
    """Origin of the moving part's frame at q = 0, axes parallel to the piece's."""
    axis: Vec3
    limit: tuple[float, float]
    """Range of q in [m] (slide) or [rad] (hinge)."""
    mass: float
    damping: float
    """Viscous damping in [N s/m] or [N m s/rad]."""
    solids: tuple[Solid, ...]
    """In the moving part's frame."""
    handle: Vec3
    """Where the gripper holds it, in the moving part's frame."""
    handle_name: str
    """The benchmark's marker name, such as `cab_push_point_5`."""

    def to_piece(self, local: FloatArray, q: float) -> FloatArray:
        """Return piece coordinates of points of the moving part at joint position q. Shape (..., 3)."""
        origin = np.asarray(self.origin)
        if self.kind == "slide":
            return np.asarray(local + origin + q * np.asarray(self.axis))
        return np.asarray(Pose(0.0, 0.0, q * self.axis[2]).to_room(local) + origin)  # hinges are vertical


@dataclass(frozen=True)
class Piece:
    """One piece of furniture, standing at `pose`."""

    name: str
    kind: str
    pose: Pose
    solids: tuple[Solid, ...]
    receptacles: tuple[Receptacle, ...] = ()
    articulations: tuple[Articulation, ...] = ()
    zones: tuple[Zone, ...] = ()


@dataclass(frozen=True)
class Apartment:
    """One of the apartments: its room, its walls and its furniture."""

    macro: int
    micro: int
    seed: int
    room: tuple[tuple[float, float], ...]
    """Corners of the floor, counter-clockwise."""
    walls: tuple[Piece, ...]
    pieces: tuple[Piece, ...]

    @property
    def name(self) -> str:
        """Such as `macro4_micro07`; with another seed than 0 the seed is part of the name."""
        name = f"macro{self.macro}_micro{self.micro:02d}"
        if self.seed == 0:
            return name
        return f"{name}_seed{self.seed}"

    def __hash__(self) -> int:
        """Of the whole record, computed once: apartments are keys wherever something is kept for them."""
        return self._hash

    @cached_property
    def _hash(self) -> int:
        return hash((self.macro, self.micro, self.seed, self.room, self.walls, self.pieces))

    @cached_property
    def fingerprint(self) -> str:
        """SHA-256 of everything in this record (12 digits): an episode names the apartment it was made for."""
        text = json.dumps(asdict(self), sort_keys=True, separators=(",", ":"), allow_nan=True)
        return hashlib.sha256(text.encode()).hexdigest()[:12]

    @cached_property
    def receptacles(self) -> tuple[Receptacle, ...]:
        """All receptacles, in the order of the pieces."""
        return tuple(r for piece in self.pieces for r in piece.receptacles)

    @cached_property
    def articulations(self) -> tuple[Articulation, ...]:
        """All drawers and doors, in the order of the pieces."""
        return tuple(a for piece in self.pieces for a in piece.articulations)

    def piece(self, name: str) -> Piece:
        """Return the piece of that name."""
        return lookup({p.name: p for p in self.pieces}, name, f"piece of {self.name}")

    def articulation(self, link: str) -> Articulation:
        """Return the drawer or door whose moving part has that name."""
        return lookup({a.link: a for a in self.articulations}, link, f"articulation of {self.name}")

    def piece_of(self, link: str) -> Piece:
        """Return the piece that carries the articulation `link`."""
        return lookup({a.link: p for p in self.pieces for a in p.articulations}, link, f"articulation of {self.name}")

    def receptacle(self, unique_name: str) -> Receptacle:
        """Return the receptacle `piece|name`."""
        return lookup({r.unique_name: r for r in self.receptacles}, unique_name, f"receptacle of {self.name}")

    def receptacles_named(self, name: str) -> tuple[Receptacle, ...]:
        """Return all receptacles with the benchmark's name `name`; two chairs give two. Refuse unknown names."""
        lookup({each.name: each for each in self.receptacles}, name, f"receptacle of {self.name}")
        return tuple(each for each in self.receptacles if each.name == name)

    def container(self, unique_name: str) -> str | None:
        """Return the drawer or door in front of receptacle `piece|name`: a link name, None when it is in the open."""
        receptacle = self.receptacle(unique_name)
        return receptacle.link or BEHIND_DOORS.get(receptacle.name)

    def is_inside(self, receptacle: Receptacle, point: FloatArray, opened: Mapping[str, float]) -> bool:
        """Return whether a point of the room is in the drawer, or behind the door, that a receptacle belongs to.

        Args:
            receptacle: A receptacle in a container of this apartment.
            point: Shape (3,).
            opened: Joint positions by link name, 0 where not given.
        """
        pose = self.piece(receptacle.piece).pose
        away = pose.to_local(point) - pose.to_local(self.surface_to_room(receptacle, np.zeros(2), opened))
        level = receptacle.link is None or -INSIDE_MARGIN < away[2] < receptacle.headroom  # any shelf behind a door
        return bool(level and (np.abs(away[:2]) < np.asarray(receptacle.half) + INSIDE_MARGIN).all())

    def is_behind_door(self, point: FloatArray) -> bool:
        """Return whether a point of the room, shape (3,), is in a container with a door: it opens only to the front."""
        behind = [each for each in self.receptacles if each.name in BEHIND_DOORS]
        return any(self.is_inside(each, point, {}) for each in behind)

    def surface_to_room(
        self, receptacle: Receptacle, uv: FloatArray, opened: Mapping[str, float] | None = None
    ) -> FloatArray:
        """Return points of a receptacle's surface in the room.

        Args:
            receptacle: One of this apartment's receptacles.
            uv: Offsets from its center along the piece's x and y in [m]. Shape (..., 2).
            opened: Joint positions by link name, 0 where not given (a drawer carries its receptacle along).

        Returns:
            Room coordinates. Shape (..., 3).
        """
        local = np.asarray(receptacle.center) + np.concatenate([uv, np.zeros_like(uv[..., :1])], axis=-1)
        if receptacle.link is not None:
            moving = self.articulation(receptacle.link)
            shift = moving.to_piece(np.zeros(3), (opened or {}).get(receptacle.link, 0.0)) - np.asarray(moving.origin)
            local = local + shift
        return self.piece(receptacle.piece).pose.to_room(local)

    def handle_to_room(self, link: str, q: float = 0.0) -> FloatArray:
        """Return where the handle of `link` is at joint position q, in room coordinates. Shape (3,)."""
        moving = self.articulation(link)
        return self.piece_of(link).pose.to_room(moving.to_piece(np.asarray(moving.handle), q))


class Container(Record, frozen=True):
    """What must be opened to get at objects: a kind of drawer, or a door such as the fridge's.

    It is declared once, in `data/furniture.json`. Facts, plans and logs call it by its name.
    """

    name: str
    links: tuple[str, ...]
    """Its articulations; an episode uses one of them."""
    closed: float
    """It counts as closed up to this joint position in [m] or [rad]."""
    opened: float
    """It counts as open from this joint position on, in [m] or [rad]."""
    open_skill: str
    close_skill: str
    start_range: tuple[float, float]
    """Uniform range of the joint position for training starts of pick from and place into it, in [m] or [rad]."""
    region_x: tuple[float, float]
    """Where navigation ends that leads to reaching into it, in the frame of `front_frame`: range of x in [m]."""
    region_half_width: float
    """The same: largest distance to the side in [m]."""
    receptacles: tuple[str, ...] = ()
    """Names of the receptacles behind its door. A receptacle in a drawer names its link itself."""

    @property
    def slides(self) -> bool:
        """Whether it is a drawer, which carries its receptacle along; else a door."""
        return _LINK_KINDS[self.links[0]] == "slide"

    @property
    def unit(self) -> str:
        """Unit of its joint position."""
        return "m" if self.slides else "rad"


class Furniture(Record, frozen=True):
    """A kind of piece. Its receptacles carry the kind in place of the piece's name."""

    note: str
    solids: tuple[Solid, ...]
    receptacles: tuple[Receptacle, ...] = ()
    articulations: tuple[Articulation, ...] = ()
    containers: tuple[Container, ...] = ()
    zones: tuple[Zone, ...] = ()


class _Data(Record, frozen=True):
    pieces: dict[str, Furniture]
    colors: dict[str, tuple[float, float, float, float]]


_DATA: _Data = read_json((Path(__file__).parents[1] / "data" / "furniture.json").read_bytes(), _Data)
FURNITURE = _DATA.pieces
"""By kind."""
COLORS = _DATA.colors
"""Red, green, blue and alpha in [0, 1], by name."""
CONTAINERS = {each.name: each for made in FURNITURE.values() for each in made.containers}
"""All containers by name."""
LINK_CONTAINERS = {link: each for each in CONTAINERS.values() for link in each.links}
"""The container of a drawer's or door's link."""
BEHIND_DOORS = {receptacle: each.links[0] for each in CONTAINERS.values() for receptacle in each.receptacles}
"""The link of the door in front of a receptacle, by the receptacle's name."""
_LINK_KINDS = {moving.link: moving.kind for made in FURNITURE.values() for moving in made.articulations}


def container_of(link: str) -> Container:
    """Return the container that a link belongs to; PerdureError for a drawer or door that is none."""
    return lookup(LINK_CONTAINERS, link, "link of a container")


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
        # Where two walls enclose a corner that juts out, each of them fills it.
        low = 0.0
        if _is_convex(before, start, end):
            low = -WALL_THICKNESS
        high = length
        if _is_convex(start, end, after):
            high = length + WALL_THICKNESS
        middle = 0.5 * (low + high)
        out = 0.5 * WALL_THICKNESS
        x = start[0] + middle * along[0] + out * along[1]
        y = start[1] + middle * along[1] - out * along[0]
        walls.append(_slab(f"wall_{k}", x, y, math.atan2(along[1], along[0]), 0.5 * (high - low), out))
    for k, (x0, y0, x1, y1) in enumerate(partitions):
        half_x = 0.5 * (x1 - x0)
        half_y = 0.5 * (y1 - y0)
        walls.append(_slab(f"partition_{k}", 0.5 * (x0 + x1), 0.5 * (y0 + y1), 0.0, half_x, half_y))
    return tuple(walls)
