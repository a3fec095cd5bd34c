"""What an object is to the physics: convex pieces, and how its mass is spread.

Whatever an object rests on is a box or a sphere, whose contacts with furniture MuJoCo has in closed form: four points
that stay where they are, so that an object that rests comes to rest, in every version of MuJoCo. Contacts of cylinders
and hulls are searched for, are up to 0.3 mm beside the point, and differ between versions: they only come into play
when an object tips.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from perdure.home.sim.arrays import Vec3
from perdure.home.sim.objects.kinds import Kind

AppleShape = Literal["sphere", "hull"]
"""What an apple is to the physics: a perfect sphere, or a convex hull whose small flat faces can come to rest."""
RELIEF = 3e-4
"""How far in [m] the pieces an object does not rest on stand back: more than a resting object sinks in (OURS)."""
CORNER = 0.018
"""Radius in [m] of the upright edges of a rounded box (OURS)."""
HULL_CORNERS = 2000
"""Corners of the apple's convex hull, evenly spread (OURS; Habitat-sim collides the hull of a scan, which we lack)."""
SIDES = 8
"""Wedges in the wall of a bowl: the corners of its rim lie on the rim's circle, four of them on the axes."""
FOOT, FLOOR = 0.031, 0.006
"""Bowl: half the side of the square plate it stands on, and its thickness, in [m] (OURS)."""
BELLY, WALL, OFF = 0.020, 0.004, 0.002
"""Bowl: height of the wall's bend, thickness of the rim, height at which the wall begins, in [m] (OURS)."""


@dataclass(frozen=True)
class ConvexPart:
    """A convex piece in the object's frame.

    Attributes:
        shape: `box`, `cylinder`, `sphere` or `hull`.
        size: Half sizes in [m]; radius, -, half height of a cylinder; radius, -, - of a sphere; unused by a hull.
        center: Its middle in [m].
        turn: Angle about z in [rad].
        rolls: Whether the object's rolling friction is this piece's.
        name: Of a hull: what its mesh is called.
        corners: Of a hull, in [m].
    """

    shape: str
    size: Vec3 = (0.0, 0.0, 0.0)
    center: Vec3 = (0.0, 0.0, 0.0)
    turn: float = 0.0
    rolls: bool = False
    name: str = ""
    corners: tuple[Vec3, ...] = ()


def pieces(kind: Kind, apple: AppleShape = "sphere") -> tuple[ConvexPart, ...]:
    """Return the convex pieces a kind collides with; a ball is a sphere or, as in Habitat-sim, a convex hull."""
    x, y, z = kind.half
    if kind.shape == "sphere" and apple == "hull":
        return (ConvexPart("hull", rolls=True, name=f"{kind.name}/hull", corners=_ball_corners(x)),)
    if kind.shape == "cylinder":
        return can_pieces(x, z)
    if kind.shape == "rounded_box":
        inside = CORNER * (1.0 - math.sqrt(0.5))
        column = ConvexPart("box", (x - inside, y - inside, z))
        return column, ConvexPart("box", (x - CORNER, y, z - RELIEF)), ConvexPart("box", (x, y - CORNER, z - RELIEF))
    if kind.shape == "bowl":
        floor = ConvexPart("box", (FOOT, FOOT, FLOOR / 2.0), (0.0, 0.0, FLOOR / 2.0 - z))
        return floor, *bowl_wall(kind)
    return (ConvexPart(kind.shape, (x, y, z), rolls=kind.shape == "sphere"),)


def _ball_corners(radius: float) -> tuple[Vec3, ...]:
    """Return `HULL_CORNERS` points on a sphere, spread by the golden angle (Fibonacci lattice)."""
    golden_angle = math.pi * (3.0 - math.sqrt(5.0))
    corners = []
    for k in range(HULL_CORNERS):
        height = 1.0 - (2.0 * k + 1.0) / HULL_CORNERS
        across, angle = math.sqrt(1.0 - height * height), golden_angle * k
        corners.append((radius * across * math.cos(angle), radius * across * math.sin(angle), radius * height))
    return tuple(corners)


def can_pieces(radius: float, half: float) -> tuple[ConvexPart, ...]:
    """Return a can: a square column to stand on, two spheres to roll on, and the edge of a cylinder to tip over.

    A can flatter than wide has no room for the spheres: on its side it rolls on the cylinder.
    """
    side = (radius - RELIEF) * math.sqrt(0.5)
    flat = half <= radius
    cylinder = ConvexPart("cylinder", (radius - RELIEF * (not flat),) * 2 + (half - RELIEF,), rolls=flat)
    column = ConvexPart("box", (side, side, half))
    if flat:
        return cylinder, column
    out = half - radius - RELIEF
    spheres = (ConvexPart("sphere", (radius,) * 3, (0.0, 0.0, at), rolls=True) for at in (-out, out))
    return cylinder, column, *spheres


def moments(kind: Kind) -> Vec3:
    """Return principal moments of inertia about the middle of the bounding box in [kg m^2].

    Boxes, cans and the apple are full; the bowl is a thin spherical cap, whose area is even in height (Archimedes), so
    that every kind's center of mass is at the middle.
    """
    x, y, z = kind.half
    if kind.shape == "sphere":
        return (0.4 * kind.mass * x**2,) * 3
    if kind.shape == "cylinder":
        across = kind.mass * (x**2 / 4.0 + z**2 / 3.0)
        return across, across, kind.mass * x**2 / 2.0
    if kind.shape == "bowl":
        # a cap of height h = 2 z on a sphere of radius R: r^2 = 2 R t - t^2 at height t, on average R h - h^2/3
        about = kind.mass * (cap_radius(kind) * 2.0 * z - (2.0 * z) ** 2 / 3.0)
        across = about / 2.0 + kind.mass * z**2 / 3.0
        return across, across, about
    third = kind.mass / 3.0
    return third * (y**2 + z**2), third * (x**2 + z**2), third * (x**2 + y**2)


def cap_radius(kind: Kind) -> float:
    """Return the radius in [m] of the sphere of which a bowl of a rim and height is a cap."""
    x, _, z = kind.half
    return (x**2 + (2.0 * z) ** 2) / (4.0 * z)


def bowl_wall(kind: Kind) -> tuple[ConvexPart, ...]:
    """Return the wedges of a bowl's wall, and four beads in its rim on which it lies when it is upside down.

    Outside a wedge goes from the foot over a bend on the cap to the rim; inside it is straight. The bend is what lets a
    tilted bowl right itself: on a straight wall it would lie still.
    """
    rim, height = kind.half[0], kind.size[2]
    top, bead = height - RELIEF, WALL / 2.0
    bend = math.sqrt(2.0 * cap_radius(kind) * BELLY - BELLY**2)
    profile = ((FOOT, OFF), (bend, BELLY), (rim, top), (rim - WALL, top), (FOOT, FLOOR))
    half = math.pi / SIDES
    corners = tuple(
        (r * math.cos(half), side * r * math.sin(half), up - height / 2.0) for side in (-1, 1) for r, up in profile
    )
    name = f"{kind.name}/wedge"
    wedges = (ConvexPart("hull", turn=(2 * k + 1) * half, name=name, corners=corners) for k in range(SIDES))
    at = rim - bead
    ends = ((at, 0.0), (0.0, at), (-at, 0.0), (0.0, -at))
    return *wedges, *(ConvexPart("sphere", (bead,) * 3, (x, y, height / 2.0 - bead)) for x, y in ends)
