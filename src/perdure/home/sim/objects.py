"""The ten YCB objects of the benchmark as MuJoCo bodies that stand, tip, roll and come to rest.

Whatever an object rests on is a box or a sphere, whose contacts with furniture MuJoCo has in closed form: four points
that stay where they are, so that an object that rests comes to rest, in every version of MuJoCo. Contacts of cylinders
and hulls are searched for, are up to 0.3 mm beside the point, and differ between versions: they only come into play
when an object tips.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from perdure.errors import PerdureError, lookup
from perdure.home.sim.arrays import FloatArray, Quaternion, Vec3
from perdure.home.sim.geoms import COLLIDES_AND_SEEN, OBJECT_BIT, ONLY_COLLIDES, ONLY_SEEN, geom_type
from perdure.schema import read_json

VISUALS, SHELLS = (Path(__file__).parents[1] / "data" / f"ycb_{name}.json" for name in ("visuals", "shells"))
Color = tuple[float, float, float]
"""Red, green and blue in [0, 1]."""
Shape = Literal["box", "rounded_box", "cylinder", "bowl", "sphere"]

SLIDING = 0.3
"""Sliding friction of every object: MS-HAB's static and dynamic friction. Bullet multiplies an object's 0.5 by the
world's 0.4, which is 0.2; MuJoCo takes the larger of a pair, and furniture has 0.2, so that the object decides."""
CAN_ROLLING = 5e-4
"""Rolling friction of the cans in [m], our choice: a tin on a table, 1.0 to 1.5 % of its weight."""
APPLE_ROLLING = 1.2e-3
"""Rolling friction of the apple in [m], our choice: 3.2 % of its weight, as it is not round."""

_SCAN = "size: scan, BOP's YCB-V model table; mass: Calli et al. 2015"
_MEASURED = "size and mass: measured, Calli et al. 2015"
_TABLE = "size: measured, Calli et al. 2015 (the scan lies askew in its frame); mass: the same"


@dataclass(frozen=True)
class Kind:
    """One object of the YCB set (Calli et al., *Benchmarking in Manipulation Research*, IEEE RAM 2015).

    Attributes:
        name: YCB name, number first.
        size: Full size of the bounding box in [m], standing upright with z up.
        mass: In [kg].
        shape: What it is to the physics.
        sliding: Sliding friction.
        rolling: Rolling friction in [m]: the lever arm of the weight that resists rolling; 0 if it has no round side.
        source: Where size and mass come from.
        color: Color where it has no label.
    """

    name: str
    size: Vec3
    mass: float
    shape: Shape
    source: str
    color: Color
    rolling: float = 0.0
    sliding: float = SLIDING

    @property
    def cylinder(self) -> bool:
        """Whether it is an upright cylinder."""
        return self.shape == "cylinder"

    @property
    def half(self) -> Vec3:
        """Half of the size in [m]."""
        x, y, z = self.size
        return x / 2.0, y / 2.0, z / 2.0


KINDS: dict[str, Kind] = {
    kind.name: kind
    for kind in (
        Kind("002_master_chef_can", (0.1024, 0.1024, 0.1401), 0.414, "cylinder", _SCAN, (0.08, 0.17, 0.5), CAN_ROLLING),
        Kind("003_cracker_box", (0.0717, 0.1640, 0.2135), 0.411, "box", _SCAN, (0.76, 0.08, 0.09)),
        Kind("004_sugar_box", (0.0495, 0.0940, 0.1760), 0.514, "box", _SCAN, (0.97, 0.8, 0.1)),
        Kind("005_tomato_soup_can", (0.0679, 0.0679, 0.1020), 0.349, "cylinder", _SCAN, (0.8, 0.07, 0.09), CAN_ROLLING),
        Kind("007_tuna_fish_can", (0.0856, 0.0856, 0.0335), 0.171, "cylinder", _SCAN, (0.12, 0.42, 0.66), CAN_ROLLING),
        Kind("008_pudding_box", (0.1100, 0.0890, 0.0350), 0.187, "box", _TABLE, (0.36, 0.2, 0.12)),
        Kind("009_gelatin_box", (0.0850, 0.0730, 0.0280), 0.097, "box", _TABLE, (0.84, 0.16, 0.3)),
        Kind("010_potted_meat_can", (0.1021, 0.0603, 0.0836), 0.370, "rounded_box", _SCAN, (0.1, 0.22, 0.56)),
        Kind("024_bowl", (0.1614, 0.1614, 0.0550), 0.147, "bowl", _SCAN, (0.74, 0.1, 0.09)),
        Kind("013_apple", (0.0750, 0.0750, 0.0750), 0.068, "sphere", _MEASURED, (0.74, 0.09, 0.1), APPLE_ROLLING),
    )
}
"""The ten kinds by their YCB name."""


def short_name(kind: str) -> str:
    """Return a YCB name without its number: `005_tomato_soup_can` is "tomato soup can"."""
    number, _, words = kind.partition("_")
    return (words if number.isdigit() and words else kind).replace("_", " ")


@dataclass(frozen=True)
class Placement:
    """An object at rest on a receptacle."""

    kind: str
    """YCB name, such as `024_bowl`."""
    position: Vec3
    """Of the object's frame in the room in [m]."""
    quaternion: Quaternion
    """(w, x, y, z), from the object's frame to the room."""
    receptacle: str
    """Unique name `piece|receptacle` in the apartment."""

    def __post_init__(self) -> None:
        """Raise PerdureError for numbers that are not finite and for quaternions that are no rotation."""
        if not all(map(math.isfinite, (*self.position, *self.quaternion))):
            raise PerdureError(f"pose of {self.kind} must be finite, not {self.position}, {self.quaternion}")
        if abs(math.hypot(*self.quaternion) - 1.0) > 1e-3:
            raise PerdureError(f"quaternion of {self.kind} must have length 1, not {self.quaternion}")


AppleShape = Literal["sphere", "hull"]
"""What an apple is to the physics: a perfect sphere, or a convex hull whose small flat faces can come to rest."""
RELIEF = 3e-4
"""How far in [m] the parts an object does not rest on stand back: more than a resting object sinks in (our choice)."""
CORNER = 0.018
"""Radius in [m] of the upright edges of a rounded box (our choice)."""
HULL_CORNERS = 2000
"""Corners of the apple's convex hull, evenly spread (our choice; Habitat-sim collides the hull of a scan, which we
lack)."""
BOWL_WEDGES = 8
"""Wedges in the wall of a bowl: the corners of its rim lie on the rim's circle, four of them on the axes."""
BOWL_BASE, BOWL_FLOOR = 0.031, 0.006
"""Bowl: half the side of the square plate it stands on, and its thickness, in [m] (our choice)."""
BOWL_BEND, BOWL_RIM, BOWL_LIFT = 0.020, 0.004, 0.002
"""Bowl: height of the wall's bend, thickness of the rim, height at which the wall begins, in [m] (our choice)."""


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


def collision_parts(kind: Kind, apple: AppleShape = "sphere") -> tuple[ConvexPart, ...]:
    """Return the convex pieces a kind collides with; a ball is a sphere or, as in Habitat-sim, a convex hull."""
    x, y, z = kind.half
    if kind.shape == "sphere" and apple == "hull":
        return (ConvexPart("hull", rolls=True, name=f"{kind.name}/hull", corners=_ball_corners(x)),)
    if kind.shape == "cylinder":
        return _can_parts(x, z)
    if kind.shape == "rounded_box":
        inside = CORNER * (1.0 - math.sqrt(0.5))
        column = ConvexPart("box", (x - inside, y - inside, z))
        return column, ConvexPart("box", (x - CORNER, y, z - RELIEF)), ConvexPart("box", (x, y - CORNER, z - RELIEF))
    if kind.shape == "bowl":
        floor = ConvexPart("box", (BOWL_BASE, BOWL_BASE, BOWL_FLOOR / 2.0), (0.0, 0.0, BOWL_FLOOR / 2.0 - z))
        return floor, *_bowl_wall(kind)
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


def _can_parts(radius: float, half: float) -> tuple[ConvexPart, ...]:
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


def _bowl_wall(kind: Kind) -> tuple[ConvexPart, ...]:
    """Return the wedges of a bowl's wall, and four beads in its rim on which it lies when it is upside down.

    Outside a wedge goes from the foot over a bend on the cap to the rim; inside it is straight. The bend is what lets a
    tilted bowl right itself: on a straight wall it would lie still.
    """
    rim, height = kind.half[0], kind.size[2]
    top, bead = height - RELIEF, BOWL_RIM / 2.0
    bend = math.sqrt(2.0 * cap_radius(kind) * BOWL_BEND - BOWL_BEND**2)
    profile = ((BOWL_BASE, BOWL_LIFT), (bend, BOWL_BEND), (rim, top), (rim - BOWL_RIM, top), (BOWL_BASE, BOWL_FLOOR))
    half = math.pi / BOWL_WEDGES
    corners = tuple(
        (r * math.cos(half), side * r * math.sin(half), up - height / 2.0) for side in (-1, 1) for r, up in profile
    )
    name = f"{kind.name}/wedge"
    wedges = (ConvexPart("hull", turn=(2 * k + 1) * half, name=name, corners=corners) for k in range(BOWL_WEDGES))
    at = rim - bead
    ends = ((at, 0.0), (0.0, at), (-at, 0.0), (0.0, -at))
    return *wedges, *(ConvexPart("sphere", (bead,) * 3, (x, y, height / 2.0 - bead)) for x, y in ends)


@dataclass(frozen=True)
class Visual:
    """A part of the visual geometry: a surface that the collision shape lacks, a label, the apple's stem or leaf.

    Attributes:
        part: Its shape; an `ellipsoid` too is a shape here.
        color: Red, green and blue.
        axis: Unit vector about which `part.turn` turns it.
    """

    part: ConvexPart
    color: Color
    axis: Vec3 = (0.0, 0.0, 1.0)


@cache
def visuals() -> dict[str, list[Visual]]:
    """Return the visual geometry by kind, drawn by eye; for bowl and apple see `shells` too."""
    drawn: dict[str, list[Visual]] = read_json(VISUALS.read_bytes(), dict[str, list[Visual]])
    return drawn


@cache
def shells() -> dict[str, list[tuple[float, float]]]:
    """Return radius and height in [m] along the surfaces of bowl and apple, which are round, the outside first."""
    drawn: dict[str, list[tuple[float, float]]] = read_json(SHELLS.read_bytes(), dict[str, list[tuple[float, float]]])
    return drawn


SHELL_CORNERS = 40
"""Corners around a shell."""


def _add_shell(spec: Any, body: Any, kind: Kind) -> Any:
    """Add the round shell of a bowl or an apple to a body; its mesh is made once in a specification.

    Returns:
        The geom.
    """
    import mujoco

    name = f"{kind.name}/shell"
    if spec.mesh(name) is None:
        corners, faces = turned(np.array(shells()[kind.name]))
        spec.add_mesh(
            name=name,
            uservert=corners.ravel(),
            userface=faces.ravel(),
            inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
        )
    return body.add_geom(type=geom_type("mesh"), meshname=name, rgba=(*kind.color, 1.0))


def turned(profile: FloatArray) -> tuple[FloatArray, NDArray[np.int32]]:
    """Return corners and triangles of a profile (radius, height) turned about the z axis, its two ends on the axis.

    The profile (n, 2) lists the outside first. Corners have shape (corners, 3), triangles, counterclockwise from
    outside, shape (triangles, 3).
    """
    angle = 2.0 * np.pi * np.arange(SHELL_CORNERS) / SHELL_CORNERS
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    rings = [np.column_stack([r * circle, np.full(SHELL_CORNERS, z)]) for r, z in profile[1:-1]]
    corners = np.concatenate([*rings, [[0.0, 0.0, profile[0, 1]], [0.0, 0.0, profile[-1, 1]]]])
    here = np.arange(SHELL_CORNERS)
    after = (here + 1) % SHELL_CORNERS
    first, last, count = len(corners) - 2, len(corners) - 1, len(rings)
    faces = [np.column_stack([after, here, np.full(SHELL_CORNERS, first)])]
    for ring in range(count - 1):
        a, b = ring * SHELL_CORNERS, (ring + 1) * SHELL_CORNERS
        faces.append(np.column_stack([a + here, a + after, b + after]))
        faces.append(np.column_stack([a + here, b + after, b + here]))
    end = (count - 1) * SHELL_CORNERS
    faces.append(np.column_stack([end + here, end + after, np.full(SHELL_CORNERS, last)]))
    return corners, np.concatenate(faces).astype(np.int32)


TORSIONAL = 0.005
"""Torsional friction in [m], MuJoCo's default. It acts where `condim` is above 3."""


@dataclass(frozen=True)
class YcbObjects:
    """The ten YCB objects.

    Attributes:
        visuals: Whether visual geometry is built (False makes a smaller model with the same physics).
        apple: What an apple is to the physics.
    """

    visuals: bool = True
    apple: AppleShape = "sphere"

    def kind(self, name: str) -> Kind:
        """Return a kind by its YCB name; PerdureError when there is none of that name."""
        return lookup(KINDS, name, "object")

    def box(self, kind: str) -> tuple[Vec3, Vec3]:
        """Return lower and upper corner of an upright object's bounding box in its own frame, in [m]."""
        x, y, z = self.kind(kind).half
        return (-x, -y, -z), (x, y, z)

    def add(self, spec: Any, kind: str, name: str, position: Vec3, quaternion: tuple[float, ...]) -> None:
        """Add an object as a free body at a pose in the world, in [m] and (w, x, y, z), to an `mujoco.MjSpec`.

        The body has the object's name, its joint is `name/free`, its geoms are `name/0`, `name/1`, ...: those that
        collide first. Its frame is at the middle of its bounding box, z up when it stands upright.
        """
        what = self.kind(kind)
        body = spec.worldbody.add_body(name=name, pos=position, quat=quaternion)
        body.add_freejoint(name=f"{name}/free")
        body.mass, body.inertia, body.explicitinertial = what.mass, moments(what), True
        body.ipos, body.iquat = (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)  # unset, MuJoCo takes the body's own pose
        hidden = self.visuals and what.shape != "box"
        for part in collision_parts(what, self.apple):
            geom = _add_part(spec, body, part)
            geom.friction = (what.sliding, TORSIONAL, what.rolling if part.rolls else 0.0)
            geom.condim = 6 if part.rolls else 3
            geom.contype |= OBJECT_BIT
            geom.conaffinity |= OBJECT_BIT
            geom.group = ONLY_COLLIDES if hidden else COLLIDES_AND_SEEN
            geom.rgba = (*what.color, 1.0)
        if self.visuals:
            seen = [_add_shell(spec, body, what)] if what.name in shells() else []
            for look in visuals().get(what.name, ()):
                seen.append(_add_part(spec, body, look.part, look.axis))
                seen[-1].rgba = (*look.color, 1.0)
            for geom in seen:
                geom.contype, geom.conaffinity, geom.group = 0, 0, ONLY_SEEN
        for k, geom in enumerate(body.geoms):
            geom.name, geom.mass = f"{name}/{k}", 0.0


def _add_part(spec: Any, body: Any, part: ConvexPart, axis: Vec3 = (0.0, 0.0, 1.0)) -> Any:
    quaternion = (math.cos(part.turn / 2.0), *(math.sin(part.turn / 2.0) * each for each in axis))
    if part.shape == "hull":
        if spec.mesh(part.name) is None:
            spec.add_mesh(name=part.name, uservert=np.array(part.corners).ravel())
        return body.add_geom(type=geom_type("mesh"), meshname=part.name, quat=quaternion)
    x, _, z = part.size
    size = {"cylinder": (x, z, 0.0), "sphere": (x, 0.0, 0.0)}.get(part.shape, part.size)
    return body.add_geom(type=geom_type(part.shape), size=size, pos=part.center, quat=quaternion)
