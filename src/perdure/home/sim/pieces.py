"""What an apartment is made of, as plain records: boxes, receptacles, articulations, pieces, the apartment.

Frames. A piece of furniture has a local frame: x points out of its front, y to its own left, z up, the origin on the
floor. The room frame is x east, y north, z up. Lengths in [m], angles in [rad], masses in [kg].
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from perdure.errors import lookup
from perdure.home.sim.arrays import FloatArray, Vec3

FRIDGE_DOOR = "top_door"
"""Link name of the fridge's upper door, the only one that opens."""
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
        cos, sin = np.cos(self.yaw), np.sin(self.yaw)
        x, y = local[..., 0], local[..., 1]
        room = np.array(local, dtype=np.float64)
        room[..., 0], room[..., 1] = self.x + cos * x - sin * y, self.y + sin * x + cos * y
        return room

    def to_local(self, room: FloatArray) -> FloatArray:
        """Return local coordinates of room points: the inverse of `to_room`. Shape (..., 2 or 3)."""
        cos, sin = np.cos(self.yaw), np.sin(self.yaw)
        x, y = room[..., 0] - self.x, room[..., 1] - self.y
        local = np.array(room, dtype=np.float64)
        local[..., 0], local[..., 1] = cos * x + sin * y, cos * y - sin * x
        return local


@dataclass(frozen=True)
class Solid:
    """One primitive of a piece: a box, or a cylinder or ellipsoid inscribed in that box, aligned with the frame."""

    name: str
    center: Vec3
    half: Vec3
    """Half extents along x, y, z; of a cylinder (radius, radius, half height)."""
    color: str
    """A name in `perdure.home.sim.furniture.COLORS`."""
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
        return f"macro{self.macro}_micro{self.micro:02d}" + (f"_seed{self.seed}" if self.seed else "")

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
        named: dict[str, tuple[Receptacle, ...]] = {}
        for receptacle in self.receptacles:
            named[receptacle.name] = (*named.get(receptacle.name, ()), receptacle)
        return lookup(named, name, f"receptacle of {self.name}")

    def container(self, unique_name: str) -> str | None:
        """Return the drawer or door in front of receptacle `piece|name`: a link name, None when it is in the open."""
        receptacle = self.receptacle(unique_name)
        return receptacle.link or (FRIDGE_DOOR if self.piece(receptacle.piece).kind == "fridge" else None)

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
