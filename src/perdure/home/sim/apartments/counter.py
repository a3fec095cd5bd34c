"""The kitchen counter: two worktops, a sink between them, seven drawers that slide.

Sizes are those of habitat-sim's copy of the ReplicaCAD counter
(`data/test_assets/URDF/kitchen_counter/kitchen_counter.urdf`, commit 5d6076a), rounded to the millimeter; that file is
y-up with z to the left of somebody facing the counter, ours is z-up with y to the counter's own left, so
(x, y, z) there is (x, -z, y) here. The marker names and the handle at 0.3 m in front of the link are M3's
(hab-mobile-manipulation, `habitat_extensions/tasks/rearrange/sim.py`). What the file does not say is marked OURS and
listed in `docs/home/benchmark.md`.
"""

from __future__ import annotations

from dataclasses import dataclass

from perdure.home.sim.apartments.motors import drawer_damping
from perdure.home.sim.apartments.piece import Articulation, Piece, Pose, Receptacle, Solid, Zone

TOP = 0.846
"""Height of the worktops in [m]."""
FRONT = 0.151
"""Where the worktops end in front, in the counter's frame in [m]."""
BACK = -0.501
LEFT_END, RIGHT_END = -1.574, 1.518
"""Extent along the counter's own y in [m]; 'left' is the left of somebody facing it, hence the smaller y."""
TRAVEL = 0.5
"""How far a drawer slides in [m]."""
HANDLE = 0.3
"""Handle in front of the link's origin in [m] (M3)."""

_SUFFIX = "kitchen_counter"


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

_WALL = 0.012
"""Half thickness of a drawer's side and back walls and of its floor in [m]."""


def _drawer_solids(spec: _Drawer) -> tuple[Solid, ...]:
    low, face, back = spec.floor, 0.301, -0.308
    middle, half_x = 0.5 * (face - spec.front + back), 0.5 * (face - spec.front - back)  # between back and front
    side_y, grip = spec.half_width - 0.01 - _WALL, 0.35 * spec.half_width
    front = 0.5 * spec.front
    return (
        Solid("floor", (middle, 0.0, low - _WALL), (half_x, spec.half_width - 0.01, _WALL), "white"),
        Solid("front", (face - front, 0.0, 0.0), (front, spec.half_width, spec.half_height), "front"),
        Solid("back", (back + _WALL, 0.0, 0.0), (_WALL, spec.half_width - 0.01, spec.half_height), "white"),
        Solid("left", (middle, side_y, 0.0), (half_x, _WALL, spec.half_height), "white"),
        Solid("right", (middle, -side_y, 0.0), (half_x, _WALL, spec.half_height), "white"),
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
        limit=(0.0, TRAVEL),
        mass=spec.mass,
        damping=drawer_damping(spec.mass),
        solids=_drawer_solids(spec),
        handle=(HANDLE, 0.0, 0.0),
        handle_name=f"cab_push_point_{spec.marker}",
    )


def _carcass() -> tuple[Solid, ...]:
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
        Solid("panel_right", (0.120, 1.012, 0.703), (0.010, 0.415, 0.070), "stone"),  # OURS: closes the gap
        Solid("panel_left", (0.120, -1.070, 0.406), (0.010, 0.444, 0.022), "stone"),  # OURS
    )


def _receptacles(name: str) -> tuple[Receptacle, ...]:
    """OURS: the regions. Worktops without the last 10 cm at the wall; in drawers, what is clear of the top at 0.4 m."""
    drawers = [(side, spec) for side, spec in (("left", _DRAWERS[1]), ("middle", _DRAWERS[4]), ("right", _DRAWERS[6]))]
    return (
        Receptacle(f"receptacle_aabb_counter_left_{_SUFFIX}", name, (-0.150, -1.080, TOP), (0.225, 0.430)),
        Receptacle(f"receptacle_aabb_counter_right_{_SUFFIX}", name, (-0.150, 0.750, TOP), (0.225, 0.700)),
        Receptacle(f"receptacle_aabb_sink_{_SUFFIX}", name, (-0.145, -0.321, 0.690), (0.060, 0.120)),
        *(
            Receptacle(
                f"receptacle_aabb_drawer_{side}_top_frl_apartment_{_SUFFIX}",
                name,
                (spec.origin[0] + 0.070, spec.origin[1], spec.origin[2] + spec.floor),
                (0.070, 0.150),
                0.780 - spec.origin[2] - spec.floor,
                spec.link,
            )
            for side, spec in drawers
        ),
    )


def kitchen_counter(name: str, pose: Pose) -> Piece:
    """Return the counter: front at local x = 0.151 m, back at -0.501 m, y from -1.574 to 1.518 m, 0.846 m high."""
    return Piece(
        name=name,
        kind="kitchen_counter",
        pose=pose,
        solids=_carcass(),
        receptacles=_receptacles(name),
        articulations=tuple(_drawer(spec) for spec in _DRAWERS),
        # OURS: a drawer out (0.5 m), the robot in front of it where M3 starts (0.95 m from the handle) and its radius
        zones=(Zone((FRONT, LEFT_END), (HANDLE - 0.159 + 0.95 + 0.35, RIGHT_END)),),
    )
