"""Tables, chairs, sofa, television stand and other pieces: functions from a name and a pose to a piece.

Outer sizes of `table_01`, `chair_01` and `sofa` are those of ReplicaCAD's objects of that name (1.40 x 0.85 m and
0.74 m high; 0.80 x 0.71 x 0.76; 2.14 x 0.96 x 0.80, as measured by users of the data set). Everything else here, and
the regions of all receptacles, is OURS: see `docs/home/benchmark.md`.
"""

from __future__ import annotations

from perdure.home.sim.apartments.piece import Piece, Pose, Receptacle, Solid, Zone


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
    """Return the coffee table: 0.60 m along x, 1.10 m along y, 0.46 m high (OURS)."""
    top = Solid("top", (0.0, 0.0, 0.445), (0.300, 0.550, 0.015), "walnut")
    shelf = Solid("shelf", (0.0, 0.0, 0.150), (0.260, 0.510, 0.010), "walnut")
    region = Receptacle("receptacle_aabb_Tbl2_Top1_frl_apartment_table_02", name, (0.0, 0.0, 0.460), (0.215, 0.460))
    return Piece(name, "table_02", pose, (top, shelf, *_legs(0.290, 0.540, 0.430, 0.050, "walnut")), (region,))


def tvstand(name: str, pose: Pose) -> Piece:
    """Return the television stand: 0.45 m along x, 1.60 m along y, 0.50 m high (OURS); the screen hangs above it."""
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
    """Return an armchair: 0.71 m along x, 0.80 m along y, 0.76 m high, its seat at 0.42 m (OURS)."""
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
    """Return the sofa: 0.96 m along x, 2.14 m along y, 0.80 m high, its seat at 0.42 m (OURS)."""
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
    """Return a pot plant (OURS): a pot of 0.34 m diameter; the leaves are visual only."""
    solids = (
        Solid("pot", (0.0, 0.0, 0.190), (0.170, 0.170, 0.190), "terracotta", shape="cylinder"),
        Solid("stem", (0.0, 0.0, 0.560), (0.025, 0.025, 0.190), "walnut", "look", "cylinder"),
        Solid("leaves_0", (0.0, 0.0, 0.900), (0.240, 0.240, 0.260), "leaf", "look", "ellipsoid"),
        Solid("leaves_1", (0.090, 0.060, 0.720), (0.180, 0.170, 0.160), "leaf", "look", "ellipsoid"),
        Solid("leaves_2", (-0.080, -0.070, 0.760), (0.170, 0.180, 0.170), "leaf", "look", "ellipsoid"),
    )
    return Piece(name, "plant", pose, solids)


def lamp(name: str, pose: Pose) -> Piece:
    """Return a floor lamp (OURS): foot of 0.28 m diameter, 1.62 m high."""
    solids = (
        Solid("foot", (0.0, 0.0, 0.015), (0.140, 0.140, 0.015), "handle", shape="cylinder"),
        Solid("pole", (0.0, 0.0, 0.690), (0.015, 0.015, 0.660), "handle", shape="cylinder"),
        Solid("shade", (0.0, 0.0, 1.480), (0.180, 0.180, 0.140), "lamp", "look", "cylinder"),
    )
    return Piece(name, "lamp", pose, solids)


def bookcase(name: str, pose: Pose) -> Piece:
    """Return a bookcase (OURS): 0.32 m along x, 0.90 m along y, 1.80 m high."""
    heights = (0.02, 0.38, 0.74, 1.10, 1.46, 1.78)
    books = ("terracotta", "fabric", "ochre", "front", "cushion")
    solids = (
        Solid("body", (-0.01, 0.0, 0.90), (0.15, 0.45, 0.90), "walnut", "hull"),
        Solid("panel", (-0.15, 0.0, 0.90), (0.01, 0.45, 0.90), "walnut", "look"),
        Solid("side_left", (0.0, 0.44, 0.90), (0.16, 0.012, 0.90), "walnut", "look"),
        Solid("side_right", (0.0, -0.44, 0.90), (0.16, 0.012, 0.90), "walnut", "look"),
        *(Solid(f"board_{k}", (0.0, 0.0, z), (0.16, 0.44, 0.012), "walnut", "look") for k, z in enumerate(heights)),
        *(
            Solid(
                f"books_{k}",
                (-0.03, -0.30 + 0.10 * k, heights[k] + 0.135),
                (0.09, 0.11 + 0.015 * k, 0.115),
                books[k],
                "look",
            )
            for k in range(5)
        ),
    )
    return Piece(name, "bookcase", pose, solids)


def rug(name: str, pose: Pose) -> Piece:
    """Return a rug (OURS): 1.70 m along x, 2.30 m along y, visual only."""
    return Piece(name, "rug", pose, (Solid("pile", (0.0, 0.0, 0.002), (0.85, 1.15, 0.002), "rug", "look"),))


def picture(name: str, pose: Pose) -> Piece:
    """Return a picture on a wall (OURS), its back at local x = 0, visual only."""
    frame = Solid("frame", (0.010, 0.0, 1.60), (0.010, 0.45, 0.30), "walnut", "look")
    return Piece(
        name, "picture", pose, (frame, Solid("sheet", (0.021, 0.0, 1.60), (0.002, 0.41, 0.26), "picture", "look"))
    )
