"""The ten YCB objects of the benchmark as MuJoCo bodies that stand, tip, roll and come to rest.

`data/objects.json` holds them (Calli et al., *Benchmarking in Manipulation Research*, IEEE RAM 2015): size, mass,
moments of inertia, colliding parts and visual geometry, which is drawn by eye. Boxes, cans and the apple are full; the
bowl is a thin spherical cap, whose area is even in height (Archimedes), so that every center of mass is at the middle.

Whatever an object rests on is a box or a sphere, whose contacts with furniture MuJoCo has in closed form: four points
that stay where they are, so that an object that rests comes to rest, in every version of MuJoCo. Contacts of cylinders
and hulls are searched for, are up to 0.3 mm beside the point, and differ between versions: they only come into play
when an object tips, and stand back by 0.3 mm, more than a resting object sinks in (our choice).

A can has a square column to stand on, two spheres to roll on, and the edge of a cylinder to tip over; one flatter than
wide rolls on the cylinder. A bowl has a square foot, eight wedges as its wall and four beads in its rim, on which it
lies when it is upside down. Outside a wedge goes from the foot over a bend on the cap to the rim; the bend is what lets
a tilted bowl right itself.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from msgspec import field
from numpy.typing import NDArray

from perdure.errors import PerdureError, lookup
from perdure.home.sim.arrays import FloatArray, Quaternion, Vec3
from perdure.home.sim.geoms import COLLIDES_AND_SEEN, OBJECT_BIT, ONLY_COLLIDES, ONLY_SEEN, ROBOT_BIT, geom_type
from perdure.schema import Record, read_json

SLIDING = 0.3
"""Sliding friction of every object: MS-HAB's static and dynamic friction. Bullet multiplies an object's 0.5 by the
world's 0.4, which is 0.2; MuJoCo takes the larger of a pair, and furniture has 0.2, so that the object decides."""
TORSIONAL = 0.005
"""Torsional friction in [m], MuJoCo's default. It acts where `condim` is above 3."""
ROLLING = 1.2e-3
"""Lever arm in [m] of the weight that resists rolling, our choice: 3.2 % of the apple's weight, as it is not round."""
AppleShape = Literal["sphere", "hull"]
"""What an apple is to the physics: a perfect sphere, or a convex hull whose small flat faces can come to rest."""


class Part(Record, frozen=True):
    """A geom of an object, in MJCF's words."""

    type: Literal["box", "cylinder", "ellipsoid", "mesh", "sphere"]
    size: tuple[float, ...] = ()
    pos: Vec3 = (0.0, 0.0, 0.0)
    quat: Quaternion = (1.0, 0.0, 0.0, 0.0)
    mesh: str = ""
    rgba: tuple[float, float, float, float] | None = None
    """Of visual geometry; what collides has the object's color."""
    rolls: bool = False
    """Whether the object rolls on it."""


class ObjectKind(Record, frozen=True):
    """One object of the YCB set."""

    size: Vec3
    """Full size of the bounding box in [m], standing upright with z up."""
    mass: float
    """In [kg]."""
    shape: Literal["box", "rounded_box", "cylinder", "bowl", "sphere"]
    axis: Literal["z", "either z", "none"]
    """What points up when the object stands as a person would put it: the z axis of its frame ("either z": this way or
    upside down); "none" for an object that lies as well in any attitude."""
    source: str
    """Where size and mass come from."""
    moments: Vec3
    """Principal moments of inertia about the middle of the bounding box in [kg m^2]."""
    color: Vec3
    """Red, green and blue where it has no label."""
    parts: tuple[Part, ...]
    """What collides."""
    visuals: tuple[Part, ...]
    meshes: dict[str, tuple[Vec3, ...]] = field(default_factory=dict)
    """Corners of convex hulls in [m] by the name of the mesh."""
    shell: tuple[tuple[float, float], ...] = ()
    """Radius and height in [m] along the round surface of bowl or apple, the outside first."""

    @property
    def cylinder(self) -> bool:
        """Whether it is an upright cylinder."""
        return self.shape == "cylinder"

    @property
    def half(self) -> Vec3:
        """Half of the size in [m]."""
        x, y, z = self.size
        return x / 2.0, y / 2.0, z / 2.0


_DATA = Path(__file__).parents[1] / "data" / "objects.json"
KINDS: dict[str, ObjectKind] = read_json(_DATA.read_bytes(), dict[str, ObjectKind])
"""The ten kinds by their YCB name, number first."""


def get_kind(name: str) -> ObjectKind:
    """Return a kind by its YCB name; PerdureError when there is none of that name."""
    return lookup(KINDS, name, "object")


def short_name(kind: str) -> str:
    """Return a YCB name without its number: `005_tomato_soup_can` is "tomato soup can"."""
    number, _, words = kind.partition("_")
    if number.isdigit() and words:
        return words.replace("_", " ")
    return kind.replace("_", " ")


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


def add_object(
    spec: Any, placement: Placement, name: str, *, visuals: bool = True, apple: AppleShape = "sphere"
) -> None:
    """Add an object as a free body to an `mujoco.MjSpec`.

    The body has the name, its joint is `name/free`, its geoms are `name/0`, `name/1`, ...: those that collide first.
    Its frame is at the middle of its bounding box, z up when it stands upright. Without `visuals` the model is smaller,
    the physics the same.
    """
    kind = get_kind(placement.kind)
    body = spec.worldbody.add_body(name=name, pos=placement.position, quat=placement.quaternion)
    body.add_freejoint(name=f"{name}/free")
    body.mass = kind.mass
    body.inertia = kind.moments
    body.explicitinertial = True
    # Unset, these two would be the body's own pose.
    body.ipos = (0.0, 0.0, 0.0)
    body.iquat = (1.0, 0.0, 0.0, 0.0)

    colliding = kind.parts
    if kind.shape == "sphere" and apple == "hull":
        colliding = (Part("mesh", mesh=f"{placement.kind}/hull", rolls=True),)
    group = COLLIDES_AND_SEEN
    if visuals and kind.shape != "box":
        group = ONLY_COLLIDES  # what is seen has geoms of its own
    parts = colliding
    if visuals:
        parts = (*colliding, *kind.visuals)
    for number, part in enumerate(parts):
        if part.mesh and spec.mesh(part.mesh) is None:
            spec.add_mesh(name=part.mesh, **_mesh(kind, part.mesh))
        geom = body.add_geom(
            name=f"{name}/{number}",
            type=geom_type(part.type),
            pos=part.pos,
            quat=part.quat,
            meshname=part.mesh,
            rgba=part.rgba or (*kind.color, 1.0),
            mass=0.0,
        )
        geom.size[: len(part.size)] = part.size
        if number < len(colliding):
            _make_collide(geom, part.rolls, group)
        else:
            geom.contype = 0
            geom.conaffinity = 0
            geom.group = ONLY_SEEN


def _make_collide(geom: Any, rolls: bool, group: int) -> None:
    """Let a geom of an object collide with the robot, the furniture and other objects."""
    geom.contype = ROBOT_BIT | OBJECT_BIT
    geom.conaffinity = ROBOT_BIT | OBJECT_BIT
    geom.group = group
    if rolls:
        geom.condim = 6
        geom.friction = (SLIDING, TORSIONAL, ROLLING)
    else:
        geom.condim = 3
        geom.friction = (SLIDING, TORSIONAL, 0.0)


HULL_CORNERS = 2000
"""Corners of the apple's convex hull, evenly spread (our choice; Habitat-sim collides the hull of a scan, which we
lack)."""


def _mesh(kind: ObjectKind, name: str) -> dict[str, Any]:
    """Return the arguments of `MjSpec.add_mesh` for one of a kind's meshes."""
    import mujoco

    if name.endswith("/shell"):
        corners, faces = turned(np.array(kind.shell))
        shell = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
        return {"uservert": corners.ravel(), "userface": faces.ravel(), "inertia": shell}
    if name in kind.meshes:
        return {"uservert": np.array(kind.meshes[name]).ravel()}
    return {"uservert": np.array(_ball_corners(kind.half[0])).ravel()}


def _ball_corners(radius: float) -> list[Vec3]:
    """Return `HULL_CORNERS` points on a sphere, spread by the golden angle (Fibonacci lattice)."""
    golden_angle = math.pi * (3.0 - math.sqrt(5.0))
    corners = []
    for k in range(HULL_CORNERS):
        height = 1.0 - (2.0 * k + 1.0) / HULL_CORNERS
        across = math.sqrt(1.0 - height * height)
        angle = golden_angle * k
        corners.append((radius * across * math.cos(angle), radius * across * math.sin(angle), radius * height))
    return corners


SHELL_CORNERS = 40
"""Corners around a shell."""


def turned(profile: FloatArray) -> tuple[FloatArray, NDArray[np.int32]]:
    """Return corners and triangles of a profile (radius, height) turned about the z axis, its two ends on the axis.

    The profile (n, 2) lists the outside first. Corners have shape (corners, 3), triangles, counterclockwise from
    outside, shape (triangles, 3).
    """
    angle = 2.0 * np.pi * np.arange(SHELL_CORNERS) / SHELL_CORNERS
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    rings = [np.column_stack([r * circle, np.full(SHELL_CORNERS, z)]) for r, z in profile[1:-1]]
    corners = np.concatenate([*rings, [[0.0, 0.0, profile[0, 1]], [0.0, 0.0, profile[-1, 1]]]])
    here = np.arange(len(rings) * SHELL_CORNERS).reshape(-1, SHELL_CORNERS)
    after = np.roll(here, -1, axis=1)
    first, last = np.full((2, SHELL_CORNERS), [[here.size], [here.size + 1]])
    halves = (here[:-1], after[:-1], after[1:]), (here[:-1], after[1:], here[1:])
    sides = np.stack([np.stack(half, axis=-1) for half in halves], axis=1).reshape(-1, 3)
    bottom = np.stack([after[0], here[0], first], axis=-1)
    top = np.stack([here[-1], after[-1], last], axis=-1)
    return corners, np.concatenate([bottom, sides, top]).astype(np.int32)
