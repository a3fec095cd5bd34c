"""Furniture and walls: functions from a name and a pose to a piece.

Outer sizes of `table_01`, `chair_01` and `sofa` are those of ReplicaCAD's objects of that name (1.40 x 0.85 m and
0.74 m high; 0.80 x 0.71 x 0.76; 2.14 x 0.96 x 0.80, as measured by users of the data set). Counter and fridge say where
theirs come from. What is marked "our choice", and the regions of all receptacles, was chosen here:
`docs/home/benchmark.md` lists it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from perdure.home.sim.pieces import FRIDGE_DOOR, Articulation, Piece, Pose, Receptacle, Solid, Zone

DECAY_TIME_S = -1.0 / (120.0 * math.log(1.0 - 0.3))
"""Time in which a free drawer or door loses 63 % of its speed, in [s].

M3 (`sim.py`) gives every joint of furniture a Bullet velocity motor with target 0, gain 0.3 and 120 steps per second:
each step leaves 0.7 of the speed, so speed decays as exp(-t / tau) with tau = 0.0234 s. As a viscous joint that is
damping = inertia / tau. The motor's impulse limit (1.0 N s per step) and the URDF's own damping and dry friction (0.01
each) are left out: they are far larger or far smaller than anything the viscous term does at the speeds of a hand.
"""


def _legs(half_x: float, half_y: float, height: float, thick: float, color: str) -> tuple[Solid, ...]:
    half = thick / 2.0
    return tuple(
        Solid(f"leg_{k}", (sx * (half_x - half), sy * (half_y - half), height / 2.0), (half, half, height / 2.0), color)
        for k, (sx, sy) in enumerate(((1, 1), (1, -1), (-1, 1), (-1, -1)))
    )


def table_01(name: str, pose: Pose) -> Piece:
    """Return the dining table: 0.85 m along x, 1.40 m along y, 0.74 m high."""
    top = Solid("top", (0.0, 0.0, 0.722), (0.425, 0.700, 0.018), "oak")
    region = Receptacle("receptacle_aabb_Tbl1_Top1_frl_apartment_table_01", name, (0.0, 0.0, 0.740), (0.340, 0.610))
    return Piece(name, "table_01", pose, (top, *_legs(0.395, 0.670, 0.704, 0.060, "oak")), (region,))


def table_02(name: str, pose: Pose) -> Piece:
    """Return the coffee table: 0.60 m along x, 1.10 m along y, 0.46 m high (our choice)."""
    top = Solid("top", (0.0, 0.0, 0.445), (0.300, 0.550, 0.015), "walnut")
    shelf = Solid("shelf", (0.0, 0.0, 0.150), (0.260, 0.510, 0.010), "walnut")
    region = Receptacle("receptacle_aabb_Tbl2_Top1_frl_apartment_table_02", name, (0.0, 0.0, 0.460), (0.215, 0.460))
    return Piece(name, "table_02", pose, (top, shelf, *_legs(0.290, 0.540, 0.430, 0.050, "walnut")), (region,))


def tvstand(name: str, pose: Pose) -> Piece:
    """Return the television stand: 0.45 m along x, 1.60 m along y, 0.50 m high (our choice); a screen above it."""
    solids = (
        Solid("body", (0.0, 0.0, 0.275), (0.225, 0.800, 0.225), "walnut"),
        Solid("plinth", (-0.010, 0.0, 0.025), (0.195, 0.760, 0.025), "handle"),
        *(
            Solid(f"door_{k}", (0.228, y, 0.275), (0.004, 0.255, 0.195), "oak", "look")
            for k, y in enumerate((-0.530, 0.0, 0.530))
        ),
        Solid("screen", (-0.200, 0.0, 1.350), (0.020, 0.620, 0.360), "screen", "look"),
    )
    region = Receptacle("receptacle_aabb_TvStnd1_Top1_frl_apartment_tvstand", name, (0.020, 0.0, 0.500), (0.120, 0.710))
    return Piece(name, "tvstand", pose, solids, (region,), zones=(Zone((0.225, -0.80), (0.90, 0.80)),))


def chair_01(name: str, pose: Pose) -> Piece:
    """Return an armchair: 0.71 m along x, 0.80 m along y, 0.76 m high, its seat at 0.42 m (our choice)."""
    solids = (
        Solid("seat", (0.045, 0.0, 0.260), (0.310, 0.300, 0.160), "ochre"),
        Solid("back", (-0.280, 0.0, 0.430), (0.075, 0.400, 0.330), "ochre"),
        Solid("arm_left", (0.070, 0.350, 0.330), (0.275, 0.050, 0.230), "ochre"),
        Solid("arm_right", (0.070, -0.350, 0.330), (0.275, 0.050, 0.230), "ochre"),
        Solid("foot", (0.0, 0.0, 0.050), (0.300, 0.330, 0.050), "walnut"),
    )
    region = Receptacle("receptacle_aabb_Chr1_Top1_frl_apartment_chair_01", name, (0.080, 0.0, 0.420), (0.190, 0.200))
    return Piece(name, "chair_01", pose, solids, (region,), zones=(Zone((0.355, -0.40), (1.05, 0.40)),))


def sofa(name: str, pose: Pose) -> Piece:
    """Return the sofa: 0.96 m along x, 2.14 m along y, 0.80 m high, its seat at 0.42 m (our choice)."""
    solids = (
        Solid("seat", (0.110, 0.0, 0.260), (0.370, 0.890, 0.160), "fabric"),
        Solid("back", (-0.370, 0.0, 0.430), (0.110, 1.070, 0.370), "fabric"),
        Solid("arm_left", (0.110, 0.980, 0.340), (0.370, 0.090, 0.240), "fabric"),
        Solid("arm_right", (0.110, -0.980, 0.340), (0.370, 0.090, 0.240), "fabric"),
        Solid("foot", (0.0, 0.0, 0.050), (0.440, 1.020, 0.050), "walnut"),
        Solid("pillow_left", (-0.205, 0.560, 0.600), (0.055, 0.290, 0.170), "cushion"),
        Solid("pillow_right", (-0.205, -0.560, 0.600), (0.055, 0.290, 0.170), "cushion"),
    )
    region = Receptacle("receptacle_aabb_Sofa_frl_apartment_sofa", name, (0.190, 0.0, 0.420), (0.210, 0.780))
    return Piece(name, "sofa", pose, solids, (region,), zones=(Zone((0.48, -0.90), (1.20, 0.90)),))


def plant(name: str, pose: Pose) -> Piece:
    """Return a pot plant (our choice): a pot of 0.34 m diameter; the leaves are visual only."""
    solids = (
        Solid("pot", (0.0, 0.0, 0.190), (0.170, 0.170, 0.190), "terracotta", shape="cylinder"),
        Solid("stem", (0.0, 0.0, 0.560), (0.025, 0.025, 0.190), "walnut", "look", "cylinder"),
        Solid("leaves_0", (0.0, 0.0, 0.900), (0.240, 0.240, 0.260), "leaf", "look", "ellipsoid"),
        Solid("leaves_1", (0.090, 0.060, 0.720), (0.180, 0.170, 0.160), "leaf", "look", "ellipsoid"),
        Solid("leaves_2", (-0.080, -0.070, 0.760), (0.170, 0.180, 0.170), "leaf", "look", "ellipsoid"),
    )
    return Piece(name, "plant", pose, solids)


def lamp(name: str, pose: Pose) -> Piece:
    """Return a floor lamp (our choice): foot of 0.28 m diameter, 1.62 m high."""
    solids = (
        Solid("foot", (0.0, 0.0, 0.015), (0.140, 0.140, 0.015), "handle", shape="cylinder"),
        Solid("pole", (0.0, 0.0, 0.690), (0.015, 0.015, 0.660), "handle", shape="cylinder"),
        Solid("shade", (0.0, 0.0, 1.480), (0.180, 0.180, 0.140), "lamp", "look", "cylinder"),
    )
    return Piece(name, "lamp", pose, solids)


def bookcase(name: str, pose: Pose) -> Piece:
    """Return a bookcase (our choice): 0.32 m along x, 0.90 m along y, 1.80 m high."""
    heights = (0.02, 0.38, 0.74, 1.10, 1.46, 1.78)
    books = ("terracotta", "fabric", "ochre", "front", "cushion")
    solids = (
        Solid("body", (-0.01, 0.0, 0.90), (0.15, 0.45, 0.90), "walnut", "hull"),
        Solid("panel", (-0.15, 0.0, 0.90), (0.01, 0.45, 0.90), "walnut", "look"),
        Solid("side_left", (0.0, 0.44, 0.90), (0.16, 0.012, 0.90), "walnut", "look"),
        Solid("side_right", (0.0, -0.44, 0.90), (0.16, 0.012, 0.90), "walnut", "look"),
        *(Solid(f"board_{k}", (0.0, 0.0, z), (0.16, 0.44, 0.012), "walnut", "look") for k, z in enumerate(heights)),
        *(
            Solid(f"books_{k}", (-0.03, -0.30 + 0.10 * k, z + 0.135), (0.09, 0.11 + 0.015 * k, 0.115), color, "look")
            for k, (z, color) in enumerate(zip(heights[:5], books, strict=True))
        ),
    )
    return Piece(name, "bookcase", pose, solids)


def rug(name: str, pose: Pose) -> Piece:
    """Return a rug (our choice): 1.70 m along x, 2.30 m along y, visual only."""
    return Piece(name, "rug", pose, (Solid("pile", (0.0, 0.0, 0.002), (0.85, 1.15, 0.002), "rug", "look"),))


def picture(name: str, pose: Pose) -> Piece:
    """Return a picture on a wall (our choice), its back at local x = 0, visual only."""
    frame = Solid("frame", (0.010, 0.0, 1.60), (0.010, 0.45, 0.30), "walnut", "look")
    return Piece(
        name, "picture", pose, (frame, Solid("sheet", (0.021, 0.0, 1.60), (0.002, 0.41, 0.26), "picture", "look"))
    )


WORKTOP = 0.846
"""Height of the worktops in [m]."""
COUNTER_FRONT = 0.151
"""Where the worktops end in front, in the counter's frame in [m]."""
COUNTER_LEFT, COUNTER_RIGHT = -1.574, 1.518
"""Extent along the counter's own y in [m]; 'left' is the left of somebody facing it, hence the smaller y."""
DRAWER_TRAVEL = 0.5
"""How far a drawer slides in [m]."""
HANDLE_AHEAD = 0.3
"""Handle in front of the link's origin in [m] (M3)."""


@dataclass(frozen=True)
class _Drawer:
    """One drawer of the URDF: its link, its joint, and the box it is, in [m] and [kg]."""

    link: str
    joint: str
    marker: int
    origin: tuple[float, float, float]
    half_width: float
    half_height: float
    floor: float
    front: float
    mass: float


_DRAWERS = (
    _Drawer("drawer1_bottom", "left_slide_bottom", 1, (-0.159, -1.070, 0.232), 0.444, 0.157, -0.106, 0.063, 5.0),
    _Drawer("drawer1_top", "left_slide_top", 2, (-0.159, -1.070, 0.600), 0.444, 0.157, -0.106, 0.063, 5.0),
    _Drawer("drawer2_bottom", "middle_slide_bottom", 3, (-0.157, 0.286, 0.180), 0.289, 0.110, -0.056, 0.049, 4.0),
    _Drawer("drawer2_middle", "middle_slide_middle", 4, (-0.157, 0.286, 0.420), 0.289, 0.110, -0.056, 0.049, 4.0),
    _Drawer("drawer2_top", "middle_slide_top", 5, (-0.157, 0.286, 0.664), 0.289, 0.110, -0.056, 0.049, 4.0),
    _Drawer("drawer4", "right_slide_bottom", 6, (-0.168, 1.019, 0.236), 0.428, 0.155, -0.114, 0.049, 6.0),
    _Drawer("drawer3", "right_slide_top", 7, (-0.168, 1.019, 0.530), 0.428, 0.093, -0.064, 0.049, 4.0),
)

_BOARD = 0.012
"""Half thickness of a drawer's side and back walls and of its floor in [m]."""


def _drawer_solids(spec: _Drawer) -> tuple[Solid, ...]:
    low, face, back = spec.floor, 0.301, -0.308
    middle, half_x = 0.5 * (face - spec.front + back), 0.5 * (face - spec.front - back)  # between back and front
    side_y, grip = spec.half_width - 0.01 - _BOARD, 0.35 * spec.half_width
    front = 0.5 * spec.front
    return (
        Solid("floor", (middle, 0.0, low - _BOARD), (half_x, spec.half_width - 0.01, _BOARD), "white"),
        Solid("front", (face - front, 0.0, 0.0), (front, spec.half_width, spec.half_height), "front"),
        Solid("back", (back + _BOARD, 0.0, 0.0), (_BOARD, spec.half_width - 0.01, spec.half_height), "white"),
        Solid("left", (middle, side_y, 0.0), (half_x, _BOARD, spec.half_height), "white"),
        Solid("right", (middle, -side_y, 0.0), (half_x, _BOARD, spec.half_height), "white"),
        Solid("bar", (face + 0.028, 0.0, 0.0), (0.007, grip, 0.008), "handle", "look"),
        Solid("post_0", (face + 0.012, grip - 0.01, 0.0), (0.012, 0.006, 0.006), "handle", "look"),
        Solid("post_1", (face + 0.012, 0.01 - grip, 0.0), (0.012, 0.006, 0.006), "handle", "look"),
    )


def _drawer(spec: _Drawer) -> Articulation:
    return Articulation(
        link=spec.link,
        joint=spec.joint,
        kind="slide",
        origin=spec.origin,
        axis=(1.0, 0.0, 0.0),
        limit=(0.0, DRAWER_TRAVEL),
        mass=spec.mass,
        damping=spec.mass / DECAY_TIME_S,
        solids=_drawer_solids(spec),
        handle=(HANDLE_AHEAD, 0.0, 0.0),
        handle_name=f"cab_push_point_{spec.marker}",
    )


def _counter_solids() -> tuple[Solid, ...]:
    return (
        Solid("top_right", (-0.175, 0.713, 0.813), (0.326, 0.805, 0.033), "oak"),
        Solid("top_left", (-0.175, -1.065, 0.813), (0.326, 0.509, 0.033), "oak"),
        Solid("plinth", (-0.175, -0.028, 0.0275), (0.326, 1.531, 0.0275), "stone"),
        Solid("under_sink", (-0.175, -0.329, 0.378), (0.326, 0.265, 0.312), "front"),
        Solid("sink_back", (-0.390, -0.323, 0.773), (0.111, 0.240, 0.074), "steel"),
        Solid("sink_front", (0.069, -0.326, 0.773), (0.079, 0.240, 0.074), "steel"),
        Solid("sink_right", (-0.146, -0.092, 0.773), (0.131, 0.032, 0.074), "steel"),
        Solid("sink_left", (-0.146, -0.550, 0.773), (0.131, 0.032, 0.074), "steel"),
        Solid("side_right", (-0.175, 1.489, 0.418), (0.318, 0.014, 0.362), "white"),
        Solid("side_left", (-0.175, -1.538, 0.418), (0.318, 0.014, 0.362), "white"),
        Solid("tap", (-0.287, -0.306, 0.906), (0.055, 0.014, 0.055), "steel"),
        Solid("panel_right", (0.120, 1.012, 0.703), (0.010, 0.415, 0.070), "stone"),  # Our choice: closes the gap
        Solid("panel_left", (0.120, -1.070, 0.406), (0.010, 0.444, 0.022), "stone"),  # Our choice
    )


def _counter_receptacles(name: str) -> tuple[Receptacle, ...]:
    """Our choice: worktops without the last 10 cm at the wall; in drawers, what is clear of the top at 0.4 m."""
    return (
        Receptacle("receptacle_aabb_counter_left_kitchen_counter", name, (-0.150, -1.080, WORKTOP), (0.225, 0.430)),
        Receptacle("receptacle_aabb_counter_right_kitchen_counter", name, (-0.150, 0.750, WORKTOP), (0.225, 0.700)),
        Receptacle("receptacle_aabb_sink_kitchen_counter", name, (-0.145, -0.321, 0.690), (0.060, 0.120)),
        *(
            Receptacle(
                f"receptacle_aabb_drawer_{side}_top_frl_apartment_kitchen_counter",
                name,
                (spec.origin[0] + 0.070, spec.origin[1], spec.origin[2] + spec.floor),
                (0.070, 0.150),
                0.780 - spec.origin[2] - spec.floor,
                spec.link,
            )
            for side, spec in (("left", _DRAWERS[1]), ("middle", _DRAWERS[4]), ("right", _DRAWERS[6]))
        ),
    )


def kitchen_counter(name: str, pose: Pose) -> Piece:
    """Return the counter: front at local x = 0.151 m, back at -0.501 m, y from -1.574 to 1.518 m, 0.846 m high.

    Sizes are those of habitat-sim's copy of the ReplicaCAD counter
    (`data/test_assets/URDF/kitchen_counter/kitchen_counter.urdf`, commit 5d6076a), rounded to the millimeter. That file
    is y-up with z to the left of somebody facing the counter, ours is z-up with y to the counter's own left, so
    (x, y, z) there is (x, -z, y) here. The marker names and the handle at 0.3 m in front of the link are M3's
    (hab-mobile-manipulation, `habitat_extensions/tasks/rearrange/sim.py`).
    """
    return Piece(
        name=name,
        kind="kitchen_counter",
        pose=pose,
        solids=_counter_solids(),
        receptacles=_counter_receptacles(name),
        articulations=tuple(_drawer(spec) for spec in _DRAWERS),
        # Our choice: a drawer out (0.5 m), the robot in front of it where M3 starts (0.95 m from the handle) and its
        # radius
        zones=(Zone((COUNTER_FRONT, COUNTER_LEFT), (HANDLE_AHEAD - 0.159 + 0.95 + 0.35, COUNTER_RIGHT)),),
    )


DOOR_LIMIT = 2.36
"""Our choice: the end of the hinge's range in [rad]; the URDF copy says 2.3, the benchmark's data set needs 2.356."""
FRIDGE_FRONT = 0.389
"""Outer face of the closed door in the fridge's frame in [m]."""
MIDDLE_SHELF, TOP_SHELF = 1.203, 1.562
"""Heights of the surfaces of the second and the first shelf in [m]."""

_DOOR_MASS, _DOOR_WIDTH, _DOOR_OFFSET = 8.0, 0.712, 0.330
_HINGE = (0.340, -0.326, 1.338)
# Our choice: the URDF's shelves reach 0.03 m into the closed door (0.3215 m); ours end where the door begins.
_SHELF_X, _SHELF_HALF_X = -0.016, 0.306


def _shelf(name: str, height: float, half: float = 0.0135) -> Solid:
    return Solid(name, (_SHELF_X, 0.0, height), (_SHELF_HALF_X, 0.345, half), "fridge")


def _fridge_solids() -> tuple[Solid, ...]:
    return (
        _shelf("top", 1.905),
        _shelf("shelf_1", TOP_SHELF - 0.0135),
        _shelf("shelf_2", MIDDLE_SHELF - 0.0135),
        _shelf("shelf_3", 0.997),
        _shelf("shelf_4", 0.707, 0.021),
        _shelf("bottom", 0.0135),
        Solid("side_left", (_SHELF_X, 0.335, 0.958), (_SHELF_HALF_X, 0.012, 0.945), "fridge"),
        Solid("side_right", (_SHELF_X, -0.335, 0.958), (_SHELF_HALF_X, 0.012, 0.945), "fridge"),
        Solid("back", (-0.3165, 0.0, 0.958), (0.0145, 0.345, 0.945), "fridge"),
        # Our choice: the lower door is fixed; no task opens it.
        Solid("bottom_door", (0.350, 0.004, 0.407), (0.040, 0.343, 0.394), "fridge"),
        Solid("bottom_bar", (0.405, 0.290, 0.640), (0.010, 0.010, 0.120), "handle", "look"),
    )


def _fridge_door() -> Articulation:
    return Articulation(
        link=FRIDGE_DOOR,
        joint="top_door_hinge",
        kind="hinge",
        origin=_HINGE,
        axis=(0.0, 0.0, -1.0),
        limit=(0.0, DOOR_LIMIT),
        mass=_DOOR_MASS,
        damping=_DOOR_MASS * (_DOOR_WIDTH**2 / 12.0 + _DOOR_OFFSET**2) / DECAY_TIME_S,  # a slab's inertia at the hinge
        solids=(
            Solid("slab", (0.0, _DOOR_OFFSET, 0.020), (0.0485, 0.356, 0.5515), "fridge"),
            Solid("bar", (0.088, 0.620, -0.200), (0.010, 0.012, 0.200), "handle", "look"),
            Solid("post_0", (0.065, 0.620, -0.030), (0.018, 0.008, 0.010), "handle", "look"),
            Solid("post_1", (0.065, 0.620, -0.370), (0.018, 0.008, 0.010), "handle", "look"),
        ),
        handle=(0.100, 0.620, -0.200),
        handle_name="fridge_push_point",
    )


def fridge(name: str, pose: Pose) -> Piece:
    """Return the fridge: 0.72 m deep with its door, 0.69 m wide, 1.92 m high, hinge on the left seen from the front.

    Sizes are those of habitat-sim's `data/test_assets/urdf/fridge/fridge.urdf` (commit 73fb07a), rounded to the
    millimeter. In that file the body's -z points up and y to the left of somebody facing the fridge; ours is z-up with
    y to the fridge's own left, so (x, y, z) there is (x, -y, 0.963 - z) here. The handle is M3's `fridge_push_point`,
    0.62 m from the hinge.

    Our choice: the benchmark's middle receptacle is taken to be the second shelf from the top (its name says
    `middle_top`, and of the upper compartment's shelves only the first two leave room for the tallest object), the
    region ends 9 cm before the door so that the door closes past whatever stands there.
    """
    return Piece(
        name=name,
        kind="fridge",
        pose=pose,
        solids=_fridge_solids(),
        receptacles=tuple(
            Receptacle(f"receptacle_aabb_{shelf}frl_apartment_refrigerator", name, (0.0, 0.0, z), (0.2, 0.23), headroom)
            for shelf, z, headroom in (("top", TOP_SHELF, 0.329), ("middle_top", MIDDLE_SHELF, 0.332))
        ),
        articulations=(_fridge_door(),),
        # Our choice: the door's swing and the floor M3's fridge skills start on (0.93 to 1.83 m before the fridge).
        zones=(Zone((FRIDGE_FRONT, -0.86), (1.95, 0.62)),),
    )


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


FURNITURE: dict[str, Callable[[str, Pose], Piece]] = {
    make.__name__: make
    for make in (
        *(kitchen_counter, fridge, table_01, table_02, tvstand, chair_01),
        *(sofa, plant, lamp, bookcase, rug, picture),
    )
}
"""Kind of piece to the function that makes one."""
