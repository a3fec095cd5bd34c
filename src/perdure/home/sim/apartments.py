"""From an apartment record to a MuJoCo model: boxes for furniture, joints for drawers and the fridge's door.

Names in the model: a piece is a body of its name (`sofa`), a moving part a body, joint and site named after its link,
joint and handle (`drawer2_top`, `middle_slide_top`, `cab_push_point_5`); a geom is `piece/solid` or
`piece/link/solid`.

Geom groups: 0 collides and is visible, 1 walls, 2 visual only, 3 collision only. Sites of handles are in group 4.

`why_not` names the first reason why an apartment is refused. It is used when micro variations are drawn; the tests look
at the apartments with independent means.

A `Spot` is one possible place of a piece. A micro variation shifts the piece along its own x and y, and turns it. The
spots for one kind are an offer: a micro variation uses as many of them as there are names.

A micro variation draws, from a generator seeded by (seed, macro, micro): which of the offered spots each piece takes,
and how far it is shifted and turned. A draw that fails one of the checks of `checks.py` is thrown away as a whole and
drawn again, so that the accepted ones are uniform among the good ones.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import count, islice
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from perdure.errors import PerdureError
from perdure.home.sim import furniture, occupancy
from perdure.home.sim.arrays import FloatArray, IntArray
from perdure.home.sim.occupancy import CLIMB, REACH_UP, FreeSpace, footprints, free_space
from perdure.home.sim.pieces import Apartment, Articulation, Piece, Pose, Receptacle, Solid, Zone, room_walls

if TYPE_CHECKING:
    import mujoco

PALETTE: dict[str, tuple[float, float, float, float]] = {
    "floor": (0.80, 0.72, 0.62, 1.0),
    "floor_dark": (0.76, 0.68, 0.58, 1.0),
    "wall": (0.93, 0.91, 0.87, 1.0),
    "oak": (0.72, 0.56, 0.40, 1.0),
    "walnut": (0.45, 0.33, 0.25, 1.0),
    "white": (0.92, 0.92, 0.90, 1.0),
    "front": (0.66, 0.71, 0.66, 1.0),
    "stone": (0.55, 0.54, 0.53, 1.0),
    "steel": (0.70, 0.72, 0.74, 1.0),
    "handle": (0.32, 0.33, 0.35, 1.0),
    "fridge": (0.80, 0.82, 0.83, 1.0),
    "glass": (0.80, 0.88, 0.90, 0.45),
    "fabric": (0.44, 0.52, 0.58, 1.0),
    "cushion": (0.56, 0.63, 0.68, 1.0),
    "ochre": (0.77, 0.62, 0.38, 1.0),
    "terracotta": (0.70, 0.46, 0.36, 1.0),
    "leaf": (0.40, 0.52, 0.38, 1.0),
    "rug": (0.74, 0.66, 0.60, 1.0),
    "screen": (0.12, 0.13, 0.15, 1.0),
    "picture": (0.62, 0.66, 0.64, 1.0),
    "lamp": (0.95, 0.90, 0.78, 1.0),
}
"""Colors (red, green, blue, alpha), each in [0, 1], by name."""
GROUPS = {"solid": 0, "wall": 1, "look": 2, "hull": 3, "handle": 4}
FRICTION = (0.2, 0.005, 0.0001)
"""Friction of furniture: low, because MuJoCo takes the larger one of a pair and the object's own is to decide."""


def build_apartment(
    apartment: Apartment, spec: mujoco.MjSpec | None = None, *, visuals: bool = True, damping_scale: float = 1.0
) -> mujoco.MjSpec:
    """Add an apartment to a MuJoCo specification.

    Args:
        apartment: What to build.
        spec: Where to add it; a new one when None. Options such as the timestep are left alone.
        visuals: Whether visual geometry is built (False makes a smaller model for training).
        damping_scale: Factor on the damping of drawers and doors.

    Returns:
        The specification, not compiled.
    """
    import mujoco

    spec = mujoco.MjSpec() if spec is None else spec
    _add_floor(spec, apartment)
    for piece in (*apartment.walls, *apartment.pieces):
        _add_piece(spec, piece, visuals, damping_scale)
    if visuals:
        _add_light(spec, apartment)
        _add_cameras(spec, apartment)
    return spec


def _add_floor(spec: Any, apartment: Apartment) -> None:
    import mujoco

    spec.add_texture(
        name="floor",
        type=mujoco.mjtTexture.mjTEXTURE_2D,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_CHECKER,
        rgb1=PALETTE["floor"][:3],
        rgb2=PALETTE["floor_dark"][:3],
        width=256,
        height=256,
    )
    material = spec.add_material(name="floor", texrepeat=(1.25, 1.25), texuniform=True)
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "floor"
    low, high = np.min(apartment.room, axis=0), np.max(apartment.room, axis=0)
    spec.worldbody.add_geom(
        name="floor",
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        pos=(*(0.5 * (low + high)), 0.0),
        size=(*(0.5 * (high - low) + 0.1), 0.05),
        material="floor",
        friction=FRICTION,
    )


def _add_piece(spec: Any, piece: Piece, visuals: bool, damping_scale: float) -> None:
    half_yaw = 0.5 * piece.pose.yaw
    body = spec.worldbody.add_body(
        name=piece.name, pos=(piece.pose.x, piece.pose.y, 0.0), quat=(math.cos(half_yaw), 0.0, 0.0, math.sin(half_yaw))
    )
    for solid in piece.solids:
        _add_solid(body, f"{piece.name}/{solid.name}", solid, visuals, "wall" if piece.kind == "wall" else None)
    for moving in piece.articulations:
        _add_articulation(spec, body, piece, moving, visuals, damping_scale)


def _add_solid(body: Any, name: str, solid: Solid, visuals: bool, group: str | None = None) -> None:
    import mujoco

    if solid.role == "look" and not visuals:
        return
    collides = int(solid.role != "look")
    body.add_geom(
        name=name,
        type=getattr(mujoco.mjtGeom, f"mjGEOM_{solid.shape.upper()}"),
        pos=solid.center,
        size=(solid.half[0], solid.half[2], 0.0) if solid.shape == "cylinder" else solid.half,
        rgba=PALETTE[solid.color],
        group=GROUPS[group or solid.role],
        contype=collides,
        conaffinity=collides,
        friction=FRICTION,
        mass=0.0,
    )


def _add_articulation(
    spec: Any, parent: Any, piece: Piece, moving: Articulation, visuals: bool, damping_scale: float
) -> None:
    import mujoco

    body = parent.add_body(name=moving.link, pos=moving.origin)
    center, inertia = _box_inertia(moving)
    body.mass, body.ipos, body.inertia, body.explicitinertial = moving.mass, center, inertia, True
    hinge = moving.kind == "hinge"
    joint = body.add_joint(
        name=moving.joint,
        type=mujoco.mjtJoint.mjJNT_HINGE if hinge else mujoco.mjtJoint.mjJNT_SLIDE,
        axis=moving.axis,
        limited=mujoco.mjtLimited.mjLIMITED_TRUE,
        range=np.degrees(moving.limit) if hinge and spec.compiler.degree else moving.limit,
    )
    damping = moving.damping * damping_scale
    joint.damping = damping if np.ndim(joint.damping) == 0 else [damping, 0.0, 0.0]  # a vector since MuJoCo 3.7
    for solid in moving.solids:
        _add_solid(body, f"{piece.name}/{moving.link}/{solid.name}", solid, visuals)
    body.add_site(name=moving.handle_name, pos=moving.handle, size=(0.02, 0.02, 0.02), group=GROUPS["handle"])
    spec.add_exclude(bodyname1=piece.name, bodyname2=moving.link)


def _box_inertia(moving: Articulation) -> tuple[np.ndarray, np.ndarray]:
    """Return middle and principal moments of a solid box that spans the part's colliding solids."""
    solids = [s for s in moving.solids if s.role != "look"]
    low = np.min([np.array(s.center) - s.half for s in solids], axis=0)
    high = np.max([np.array(s.center) + s.half for s in solids], axis=0)
    square = (high - low) ** 2
    return 0.5 * (low + high), moving.mass / 12.0 * (square.sum() - square)


def _add_light(spec: Any, apartment: Apartment) -> None:
    import mujoco

    spec.visual.headlight.ambient, spec.visual.headlight.diffuse = (0.42, 0.42, 0.42), (0.32, 0.32, 0.32)
    spec.visual.headlight.specular = (0.05, 0.05, 0.05)
    spec.add_texture(
        name="sky",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=(0.93, 0.94, 0.95),
        rgb2=(0.78, 0.81, 0.84),
        width=64,
        height=384,
    )
    spec.worldbody.add_light(
        name="sun",
        type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
        pos=(*np.mean(apartment.room, axis=0), 6.0),
        dir=(0.12, 0.16, -1.0),
        diffuse=(0.38, 0.37, 0.35),
        specular=(0.05, 0.05, 0.05),
        castshadow=True,
    )


def _add_cameras(spec: Any, apartment: Apartment) -> None:
    """`plan` looks straight down, `doll_house` at the kitchen's front from above."""
    low, high = np.min(apartment.room, axis=0), np.max(apartment.room, axis=0)
    middle, (width, depth) = 0.5 * (low + high), high - low
    distance = max(depth, 0.75 * width) / (2.0 * math.tan(math.radians(22.5))) + 0.5
    spec.worldbody.add_camera(name="plan", pos=(*middle, distance), fovy=45.0)
    yaw = next((p.pose.yaw for p in apartment.pieces if p.kind == "kitchen_counter"), math.pi / 2.0)
    away = 0.95 * max(width, depth) * np.array([math.cos(yaw), math.sin(yaw), 0.0])
    target = np.array([*middle, 0.2])
    _look_at(spec, "doll_house", target + away + [0.0, 0.0, 0.95 * max(width, depth)], target)


def _look_at(spec: Any, name: str, eye: np.ndarray, target: np.ndarray) -> None:
    """A camera at `eye` that looks at `target`, the horizon level."""
    import mujoco

    backward = (eye - target) / np.linalg.norm(eye - target)
    right = np.cross((0.0, 0.0, 1.0), backward)
    right /= np.linalg.norm(right)
    up = np.cross(backward, right)
    quat = np.empty(4)
    mujoco.mju_mat2Quat(quat, np.stack([right, up, backward], axis=1).ravel())
    spec.worldbody.add_camera(name=name, pos=eye, quat=quat, fovy=45.0)


def cut_away(model: Any, apartment: Apartment, eye: NDArray[np.float64]) -> None:
    """Make the walls (and the pictures on them) between a camera at `eye` (3,) and the room invisible.

    Colors of the compiled model are changed in place.
    """
    for piece in (*apartment.walls, *apartment.pieces):
        if piece.kind not in ("wall", "picture") or piece.name.startswith("partition"):
            continue
        facing = piece.pose.yaw + (np.pi / 2.0 if piece.kind == "wall" else 0.0)  # direction of its room side
        if (eye[0] - piece.pose.x) * np.cos(facing) + (eye[1] - piece.pose.y) * np.sin(facing) < 0.0:
            for solid in piece.solids:
                model.geom(f"{piece.name}/{solid.name}").rgba[3] = 0.0


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
    close = np.where(one_wall, occupancy.overlap(shapes, shapes), occupancy.overlap(shapes, shapes, GAP))
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
    inside = occupancy.overlap(np.concatenate([area for _, area in zones]), shapes)
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


MACROS = 5
"""Number of macro layouts, as in ReplicaCAD."""


@dataclass(frozen=True)
class Spot:
    """A place for a piece: pose in [m] and [degrees], and the largest shift along x, y and turn around it."""

    x: float
    y: float
    yaw_deg: float
    shift: tuple[float, float] = (0.0, 0.0)
    turn_deg: float = 0.0


@dataclass(frozen=True)
class Offer:
    """Which pieces to place (names) on which of the spots."""

    kind: str
    names: tuple[str, ...]
    spots: tuple[Spot, ...]


@dataclass(frozen=True)
class Macro:
    """One macro layout: the floor's corners counter-clockwise, partition walls (x0, y0, x1, y1), and the offers."""

    room: tuple[tuple[float, float], ...]
    partitions: tuple[tuple[float, float, float, float], ...]
    offers: tuple[Offer, ...]


_ALONG = (0.0, 0.20)
"""Shift along a wall only."""
_FREE = (0.15, 0.15)
_ANY_WAY = (0.0, (0.04, 0.04), 180.0)
"""Yaw, shift and turn of round pieces, of which only x and y are given."""
_NAMES = {"chair_01": ("chair_01_0", "chair_01_1"), "plant": ("plant_0", "plant_1")}
"""Names of the kinds that come in several pieces."""


def _macro(
    room: tuple[tuple[float, float], ...],
    *,
    partitions: tuple[tuple[float, float, float, float], ...] = (),
    **spots: list[tuple[Any, ...]],
) -> Macro:
    """Return a macro layout from the spots of each kind: (x, y, yaw, shift, turn), see `Spot`. Their order matters."""
    offers = (
        Offer(kind, _NAMES.get(kind, (kind,)), tuple(Spot(*row, *(_ANY_WAY if len(row) == 2 else ())) for row in rows))
        for kind, rows in spots.items()
    )
    return Macro(room, partitions, tuple(offers))


_ALL = (
    _macro(
        ((0.0, 0.0), (8.4, 0.0), (8.4, 6.0), (0.0, 6.0)),
        kitchen_counter=[(3.20, 5.495, -90.0)],
        fridge=[(1.22, 5.664, -90.0)],
        table_01=[(6.80, 3.80, 0.0, _FREE, 6.0), (6.60, 3.70, 90.0, _FREE, 6.0)],
        sofa=[(4.30, 2.05, 180.0, (0.15, 0.15), 4.0)],
        tvstand=[(0.235, 1.95, 0.0, _ALONG)],
        table_02=[(2.15, 2.00, 0.0, (0.10, 0.15), 6.0)],
        chair_01=[
            (2.20, 0.50, 90.0, (0.05, 0.20), 10.0),
            (7.65, 0.75, 135.0, _FREE, 15.0),
            (5.90, 0.55, 90.0, (0.05, 0.20), 15.0),
            (0.75, 3.55, -30.0, (0.10, 0.10), 15.0),
        ],
        bookcase=[(5.60, 5.835, -90.0, (0.0, 0.15)), (8.235, 2.00, 180.0, _ALONG)],
        plant=[(8.10, 5.70), (0.30, 0.30), (6.70, 5.70), (4.20, 0.30)],
        lamp=[(0.30, 3.20), (7.00, 0.30), (8.15, 5.10)],
        rug=[(2.45, 2.00, 0.0, (0.10, 0.10), 4.0)],
        picture=[(8.40, 3.60, 180.0, (0.0, 0.40)), (3.10, 0.0, 90.0, (0.0, 0.40))],
    ),
    _macro(
        ((0.0, 0.0), (9.0, 0.0), (9.0, 4.3), (5.2, 4.3), (5.2, 7.0), (0.0, 7.0)),
        kitchen_counter=[(0.505, 5.30, 0.0)],
        fridge=[(0.336, 3.32, 0.0)],
        table_01=[(3.55, 5.35, 0.0, _FREE, 6.0), (3.55, 5.20, 90.0, _FREE, 6.0)],
        sofa=[(6.40, 0.51, 90.0, (0.0, 0.20))],
        tvstand=[(6.55, 4.065, -90.0, _ALONG)],
        table_02=[(6.45, 2.15, 90.0, (0.10, 0.15), 6.0)],
        chair_01=[
            (8.40, 2.10, 180.0, (0.05, 0.15), 12.0),
            (2.80, 0.50, 90.0, (0.05, 0.25), 12.0),
            (4.10, 2.60, -20.0, (0.10, 0.10), 15.0),
            (0.55, 1.10, 20.0, (0.10, 0.15), 12.0),
        ],
        bookcase=[(5.035, 6.00, 180.0, (0.0, 0.15)), (1.70, 0.165, 90.0, (0.0, 0.20))],
        plant=[(8.70, 0.30), (8.70, 4.00), (4.90, 6.70), (0.30, 0.30)],
        lamp=[(4.95, 0.30), (8.20, 0.30), (4.90, 4.60)],
        rug=[(6.40, 2.10, 90.0, (0.10, 0.10), 4.0)],
        picture=[(3.40, 7.00, -90.0, (0.0, 0.40)), (0.0, 1.40, 0.0, (0.0, 0.40))],
    ),
    _macro(
        ((0.0, 0.0), (10.2, 0.0), (10.2, 5.0), (0.0, 5.0)),
        kitchen_counter=[(9.695, 1.70, 180.0)],
        fridge=[(9.864, 3.70, 180.0)],
        table_01=[(6.80, 2.40, 0.0, (0.10, 0.20), 6.0), (6.70, 2.50, 90.0, (0.10, 0.20), 6.0)],
        sofa=[(4.05, 2.55, 180.0, (0.15, 0.15), 4.0)],
        tvstand=[(0.235, 2.50, 0.0, _ALONG)],
        table_02=[(2.05, 2.50, 0.0, (0.10, 0.10), 6.0)],
        chair_01=[
            (2.10, 0.50, 90.0, (0.05, 0.20), 10.0),
            (2.10, 4.50, -90.0, (0.05, 0.20), 10.0),
            (5.60, 0.55, 90.0, (0.05, 0.20), 12.0),
            (6.10, 4.45, -90.0, (0.05, 0.25), 12.0),
        ],
        bookcase=[(4.40, 4.835, -90.0, (0.0, 0.25)), (4.30, 0.165, 90.0, (0.0, 0.25))],
        plant=[(0.30, 0.30), (0.30, 4.70), (7.40, 0.30), (7.90, 4.70)],
        lamp=[(0.30, 1.10), (0.30, 4.00), (3.20, 4.70)],
        rug=[(2.30, 2.50, 0.0, (0.10, 0.10), 4.0)],
        picture=[(6.70, 5.00, -90.0, (0.0, 0.50)), (6.80, 0.0, 90.0, (0.0, 0.50))],
    ),
    _macro(
        ((0.0, 0.0), (8.0, 0.0), (8.0, 7.4), (0.0, 7.4)),
        partitions=((0.0, 3.80, 4.70, 3.90),),
        kitchen_counter=[(3.10, 6.895, -90.0)],
        fridge=[(0.336, 5.10, 0.0)],
        table_01=[(6.55, 5.40, 0.0, _FREE, 6.0), (6.40, 5.50, 90.0, _FREE, 6.0)],
        sofa=[(2.40, 0.51, 90.0, (0.0, 0.20))],
        tvstand=[(2.35, 3.565, -90.0, _ALONG)],
        table_02=[(2.40, 2.05, 90.0, (0.05, 0.15), 6.0)],
        chair_01=[
            (0.50, 2.10, 0.0, (0.05, 0.15), 10.0),
            (5.00, 0.50, 90.0, (0.05, 0.20), 12.0),
            (7.40, 1.70, 180.0, (0.08, 0.20), 12.0),
            (7.35, 3.30, 180.0, (0.08, 0.15), 12.0),
        ],
        bookcase=[(5.60, 7.235, -90.0, (0.0, 0.20)), (6.30, 0.165, 90.0, (0.0, 0.20))],
        plant=[(7.70, 0.30), (0.30, 0.30), (7.70, 7.10), (4.05, 0.30)],
        lamp=[(0.30, 3.50), (7.70, 6.30), (3.85, 3.45)],
        rug=[(2.40, 2.00, 90.0, (0.10, 0.10), 4.0)],
        picture=[(8.00, 5.30, 180.0, (0.0, 0.50)), (2.40, 3.90, 90.0, (0.0, 0.40))],
    ),
    _macro(
        ((0.0, 0.0), (6.4, 0.0), (6.4, 2.6), (9.4, 2.6), (9.4, 7.2), (3.2, 7.2), (3.2, 5.0), (0.0, 5.0)),
        kitchen_counter=[(1.80, 0.505, 90.0)],
        fridge=[(3.80, 0.336, 90.0)],
        table_01=[(4.30, 4.00, 0.0, _FREE, 6.0), (4.10, 3.90, 90.0, _FREE, 6.0)],
        sofa=[(8.89, 5.00, 180.0, (0.0, 0.15))],
        tvstand=[(7.00, 6.965, -90.0, _ALONG)],
        table_02=[(7.20, 5.00, 0.0, (0.10, 0.10), 6.0)],
        chair_01=[
            (7.20, 3.10, 90.0, (0.05, 0.20), 10.0),
            (0.50, 3.30, 0.0, (0.05, 0.20), 12.0),
            (4.00, 6.55, -60.0, (0.10, 0.10), 12.0),
            (0.75, 4.45, -50.0, (0.08, 0.08), 12.0),
        ],
        bookcase=[(1.90, 4.835, -90.0, (0.0, 0.15)), (5.60, 7.035, -90.0, (0.0, 0.15))],
        plant=[(9.10, 2.90), (9.10, 6.90), (6.10, 0.30), (3.50, 5.35)],
        lamp=[(5.95, 2.30), (8.30, 2.85), (8.30, 6.95)],
        rug=[(7.50, 4.90, 0.0, (0.10, 0.10), 4.0)],
        picture=[(0.0, 2.30, 0.0, (0.0, 0.30)), (6.40, 1.30, 180.0, (0.0, 0.20))],
    ),
)


def macro_layout(macro: int) -> Macro:
    """Return the macro layout of a number, 0 to 4; another number raises PerdureError."""
    if not 0 <= macro < MACROS:
        raise PerdureError(f"macro layout must be one of 0 to {MACROS - 1}, not {macro}")
    return _ALL[macro]


MICROS = 21
"""Number of micro variations of each macro layout, as in ReplicaCAD."""
_DRAWS = 500
_KINDS = {
    "kitchen_counter": furniture.kitchen_counter,
    "fridge": furniture.fridge,
    "table_01": furniture.table_01,
    "table_02": furniture.table_02,
    "tvstand": furniture.tvstand,
    "chair_01": furniture.chair_01,
    "sofa": furniture.sofa,
    "plant": furniture.plant,
    "lamp": furniture.lamp,
    "bookcase": furniture.bookcase,
    "rug": furniture.rug,
    "picture": furniture.picture,
}
THROWN_AWAY: Mapping[int, tuple[int, ...]] = {
    0: (5, 3, 7, 0, 10, 20, 1, 3, 1, 6, 1, 1, 1, 0, 1, 0, 5, 5, 0, 7, 0),
    1: (1, 0, 2, 0, 4, 2, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 1, 0, 0),
    2: (0, 0, 0, 4, 0, 0, 0, 1, 1, 2, 1, 1, 0, 3, 0, 0, 1, 0, 1, 1, 1),
    3: (0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 2, 0, 1, 0, 0, 0, 0),
    4: (0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 1, 0, 1),
}
"""Macro layout to the number of draws of each micro variation, with seed 0, that failed a check.

Kept because a check takes a tenth of a second. `tests/home/sim/apartments` draws and checks all of them again.
"""
SPLITS: dict[str, tuple[tuple[int, int], ...]] = {
    "train": tuple((macro, micro) for macro in range(4) for micro in range(16)),
    "val": tuple((macro, micro) for macro in range(4) for micro in range(16, 21)),
    "eval": tuple((4, micro) for micro in range(20)),
}
"""(macro, micro) of each split, as in M3 (`scripts/generate_episodes.sh`).

64 for training, 20 new configurations of the same layouts (val), 20 of a new layout (eval; M3 uses the first 20 of 21).
"""


@lru_cache(maxsize=128)
def make_apartment(macro: int, micro: int, seed: int = 0) -> Apartment:
    """Return macro layout 0 to 4 in micro variation 0 to 20, the same on every machine.

    Other seeds give other sets of 105 apartments; the published ones are those of seed 0.
    """
    drawn = drafts(macro, micro, seed)
    if seed == 0:
        return next(islice(drawn, THROWN_AWAY[macro][micro], None))
    for apartment in islice(drawn, _DRAWS):
        if why_not(apartment) is None:
            return apartment
    raise PerdureError(f"no micro variation of macro {macro} fits: {_DRAWS} draws of micro {micro}, seed {seed} failed")


def drafts(macro: int, micro: int, seed: int) -> Iterator[Apartment]:
    """Return all draws of a micro variation, good or not, without an end; PerdureError where there is no such one."""
    layout = macro_layout(macro)
    if not 0 <= micro < MICROS:
        raise PerdureError(f"micro variation must be one of 0 to {MICROS - 1}, not {micro}")
    rng = np.random.Generator(np.random.PCG64([seed, macro, micro]))
    walls = room_walls(layout.room, layout.partitions)
    return (Apartment(macro, micro, seed, layout.room, walls, _draw_pieces(layout, rng)) for _ in count())


def _draw_pieces(layout: Macro, rng: np.random.Generator) -> tuple[Piece, ...]:
    pieces = []
    for offer in layout.offers:
        order = np.argsort(rng.random(len(offer.spots)), kind="stable")
        for name, choice in zip(offer.names, order, strict=False):
            pieces.append(_KINDS[offer.kind](name, _draw_pose(offer.spots[choice], rng)))
    return tuple(pieces)


def _draw_pose(spot: Spot, rng: np.random.Generator) -> Pose:
    """Return a pose near a spot; rounded, so that no machine's last bit can change an apartment."""
    shift_x, shift_y, turn = (2.0 * rng.random(3) - 1.0) * (*spot.shift, spot.turn_deg)
    place = Pose(spot.x, spot.y, math.radians(spot.yaw_deg)).to_room(np.array([shift_x, shift_y]))
    return Pose(round(float(place[0]), 4), round(float(place[1]), 4), round(math.radians(spot.yaw_deg + turn), 4))


def split_apartments(split: str) -> tuple[tuple[int, int], ...]:
    """Return the (macro, micro) pairs of `train`, `val` (cross-configuration) or `eval` (cross-layout)."""
    if split not in SPLITS:
        raise PerdureError(f"split must be one of {', '.join(SPLITS)}, not {split!r}")
    return SPLITS[split]
