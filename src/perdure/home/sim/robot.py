"""The Fetch robot as MJCF: links, servos, collision shapes, visual geometry.

Every number is from Fetch Robotics' own `fetch_description/robots/fetch.urdf` (fetch_ros, commit 0dbc193), in which all
link frames are parallel when the joints are at 0: x forward, y left, z up. Left out: the bellows, emergency stop and
laser (0.35 kg together). Rigidly attached parts (wheels, fixed torso, head) are one body with what carries them.

A position servo pulls with kp (target - q) - kv q', clipped at the motor's effort. Its gains come from the inertia I
it was made for: kp = I w^2 and kv = 2 z I w, with w = 60 rad/s and z = 0.7 (our choice: the benchmark's own motors
follow almost at once, and so must these). A target that moves at speed v is then followed 2 z v / w behind: 0.018 rad
at the largest command, 0.025 rad per 1/30 s. Every joint gets rotor inertia (armature), as geared motors have, without
which links of 0.002 kg m^2 could not be held stiffly at steps of 1/120 s.

The robot meets furniture, floor and objects, but not itself, with one exception: the links after the elbow carry a
second collision bit and meet base, torso and head, so that the hand cannot pass through the body.

`data/fetch.json` holds masses, links, collision shapes and colors. Our choice there: the inertia each servo is made for
(the arm stretched out, rotor included) and that of the rotor alone (armature); a base 4 cm above the floor, as it
slides on its joints and not on contacts; an effort of the shoulder pan of 200 N m, as the URDF's 33.82 N m cannot hold
the arm when the base starts or stops within 0.2 s, as the benchmark's base does (its own motors push with up to 10 N m
s in 1/120 s). The URDF's finger has moments (0.002, 0, 0), which no body can have; ours are those of the finger's box.
The faces of closed fingers are 0.6 mm apart; `l` is on the side of -y, as in the URDF. The colors blue, gray and red
are the URDF's. The visual geometry is drawn by eye to the sizes of the links (our choice): `data/fetch_visuals.json`.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from perdure.home.sim.arrays import FloatArray, Quaternion, Vec3
from perdure.home.sim.geoms import (
    COLLIDES_AND_SEEN,
    FRICTION,
    HAND_BIT,
    HIDDEN,
    ONLY_COLLIDES,
    ONLY_SEEN,
    ROBOT_BIT,
    add_joint,
    camera_quaternion,
    geom_type,
)
from perdure.schema import Record, read_json

if TYPE_CHECKING:
    import mujoco

Vec6 = tuple[float, float, float, float, float, float]


class Inertial(Record, frozen=True):
    """Mass in [kg], center of mass in [m], moments about it (xx, yy, zz, xy, xz, yz) in [kg m^2]."""

    mass: float
    center: Vec3
    moments: Vec6


def combined(parts: tuple[Inertial, ...]) -> Inertial:
    """Return mass, center and moments of several rigidly joined parts (parallel axis theorem)."""
    mass = sum(part.mass for part in parts)
    center: FloatArray = np.sum([part.mass * np.array(part.center) for part in parts], axis=0) / mass
    tensor = np.zeros((3, 3))
    for part in parts:
        xx, yy, zz, xy, xz, yz = part.moments
        arm = np.array(part.center) - center
        tensor += [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]
        tensor += part.mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    x, y, z = center.tolist()
    xx, yy, zz = np.diag(tensor).tolist()
    return Inertial(mass, (x, y, z), (xx, yy, zz, float(tensor[0, 1]), float(tensor[0, 2]), float(tensor[1, 2])))


class Link(Record, frozen=True):
    """One moving body and the joint that carries it."""

    body: str
    parent: str
    joint: str
    kind: Literal["hinge", "slide"]
    axis: Vec3
    origin: Vec3
    """The joint in the parent's frame in [m]."""
    limit: tuple[float, float] | None
    """Range in [rad] or [m], None for a continuous joint."""
    effort: float
    """Largest torque in [N m] or force in [N]."""
    inertia: float
    """What the servo is made for, in [kg m^2] or [kg]."""
    armature: float
    """Inertia of the rotor."""
    parts: tuple[Inertial, ...]
    """What it weighs, in its own frame."""


class CollisionShape(Record, frozen=True):
    """One primitive in the frame of its body; sizes in [m]."""

    body: str
    name: str
    kind: Literal["box", "cylinder", "capsule"]
    center: Vec3
    half: Vec3
    """Box: half extents. Cylinder and capsule: (radius, half length, 0) along z, or along x for an arm's capsule."""
    part_of: Literal["body", "arm", "hand"]


class _Fetch(Record, frozen=True):
    base: tuple[Inertial, ...]
    """The base, its wheels and the fixed part of the torso, in the base frame."""
    gripper: Inertial
    links: tuple[Link, ...]
    """The torso, the seven links of the arm from the shoulder to the wrist, the two fingers."""
    shapes: tuple[CollisionShape, ...]
    colors: dict[str, tuple[float, float, float, float]]


_DATA = Path(__file__).parents[1] / "data"
_FETCH: _Fetch = read_json((_DATA / "fetch.json").read_bytes(), _Fetch)
LINKS = _FETCH.links
TORSO, ARM, FINGERS = LINKS[0], LINKS[1:8], LINKS[8:]

GRIPPER_ORIGIN: Vec3 = (0.16645, 0.0, 0.0)
"""`gripper_link` in the frame of `wrist_roll_link`, to which it is fixed."""
GRIPPER_POINT: Vec3 = (-0.01, -0.0001, -0.0017)
"""M3's gripper point in the frame of `gripper_link` in [m]: what is near or far, and what a held object hangs on."""
BASE_JOINTS = ("base_x", "base_y", "base_yaw")
"""Slides along the room's x and y in [m], then the heading in [rad]."""
ARM_JOINTS = tuple(link.joint for link in ARM)
"""The seven joints of the arm, from the shoulder to the wrist."""
JOINTS = (*BASE_JOINTS, *(link.joint for link in LINKS))
"""All joints and all actuators, in the order of the model."""

ARM_LOW = tuple(-math.inf if link.limit is None else link.limit[0] for link in ARM)
ARM_HIGH = tuple(math.inf if link.limit is None else link.limit[1] for link in ARM)
"""Limits of the arm in [rad] (URDF); the three rolls turn without end."""
ROLLS = [number for number, link in enumerate(ARM) if link.limit is None]
"""Joints of the arm that turn without end."""
BASE_RADIUS = 0.285
"""Of the base, a cylinder, in [m]."""
TORSO_HEIGHT = 0.15
"""Where the benchmark keeps the torso in [m] (M3, habitat-lab: `torso_lift_joint` pinned each step)."""

OPEN = 0.04
"""Position of each finger of M3's open gripper in [m]."""

REST_POSITION = (0.5, 0.0, 1.0)
"""Where the gripper rests in the base frame in [m] (M3 and habitat-lab: resting position)."""
# M3's initial pose (-.268, -1.133, .367, 1.081, .06, 2.002, .067) brings `gripper_link` there to the millimeter and the
# gripper point 1 cm above; from it inverse kinematics found this one, with the same direction of the fingers.
REST_ARM = (-0.270325, -1.141013, 0.369315, 1.122742, 0.061235, 1.968084, 0.065927)
"""Joint angles of the arm at rest in [rad]."""


STIFFNESS_RATE = 60.0
"""Natural frequency w of the position servos in [rad/s]."""
DAMPING_RATIO = 0.7

BASE_GAIN = {"base_x": 10_000.0, "base_y": 10_000.0, "base_yaw": 500.0}
"""Our choice: force per velocity error in [N s/m], [N m s/rad]: the base follows within 12 to 20 ms."""
BASE_FORCE = {"base_x": 800.0, "base_y": 800.0, "base_yaw": 150.0}
"""Our choice: what the wheels can pass to the floor, 0.67 of the robot's weight of 121 kg; torque at 0.187 m."""


def add_servos(spec: Any) -> None:
    """Add the thirteen actuators, each named after its joint, in the order of the joints."""
    for joint, gain in BASE_GAIN.items():
        _add_servo(spec, joint, gain, (0.0, 0.0, -gain), BASE_FORCE[joint])
    for link in LINKS:
        kp, kv = link.inertia * STIFFNESS_RATE**2, 2.0 * DAMPING_RATIO * link.inertia * STIFFNESS_RATE
        _add_servo(spec, link.joint, kp, (0.0, -kp, -kv), link.effort, link.limit)


def _add_servo(
    spec: Any, joint: str, gain: float, bias: Vec3, force: float, limit: tuple[float, float] | None = None
) -> None:
    import mujoco

    actuator = spec.add_actuator(
        name=joint,
        target=joint,
        trntype=mujoco.mjtTrn.mjTRN_JOINT,
        gaintype=mujoco.mjtGain.mjGAIN_FIXED,
        biastype=mujoco.mjtBias.mjBIAS_AFFINE,
        forcelimited=mujoco.mjtLimited.mjLIMITED_TRUE,
        forcerange=(-force, force),
        ctrllimited=mujoco.mjtLimited.mjLIMITED_FALSE if limit is None else mujoco.mjtLimited.mjLIMITED_TRUE,
        ctrlrange=(0.0, 0.0) if limit is None else limit,
    )
    actuator.gainprm[0] = gain
    actuator.biasprm[:3] = bias


BITS = {"body": (ROBOT_BIT, HAND_BIT), "arm": (ROBOT_BIT, 0), "hand": (ROBOT_BIT | HAND_BIT, 0)}
"""(contype, conaffinity) by what a shape is part of."""


class Visual(Record, frozen=True):
    """One primitive in the frame of its body; sizes in [m]."""

    kind: Literal["box", "ellipsoid", "cylinder", "capsule"]
    color: str
    center: Vec3
    half: Vec3
    """Box and ellipsoid: half extents. Cylinder and capsule: (radius, half length, 0)."""
    axis: Literal["x", "y", "z"] = "z"
    """Of cylinder and capsule."""
    pitch: float = 0.0
    """Turn about y in [rad], downwards in front; the head looks down by 0.332 rad."""

    @property
    def quaternion(self) -> Quaternion:
        """(w, x, y, z): the axis is turned to its place, then the pitch."""
        if self.axis == "y":  # a quarter turn about x first
            a, b = math.cos(0.5 * self.pitch) * math.sqrt(0.5), math.sin(0.5 * self.pitch) * math.sqrt(0.5)
            return a, a, b, -b
        half = 0.5 * self.pitch + (0.25 * math.pi if self.axis == "x" else 0.0)
        return math.cos(half), 0.0, math.sin(half), 0.0


HEAD_CAMERA: Vec3 = (0.256875, 0.0, 0.67257)
"""In the torso's frame: with the torso at 0.15 m M3's (0.17, 0, 1.2) in the base frame."""
HEAD_LOOKS_AT: Vec3 = (0.836875, 0.0, 0.47257)
"""The same for M3's (0.75, 0, 1.0)."""
HAND_CAMERA: Vec3 = (0.0, 0.0, 0.1)
"""In the frame of `gripper_link`; it looks along the gripper's x (M3)."""


def add_fetch(spec: mujoco.MjSpec, *, visuals: bool = True) -> None:
    """Add the robot to a MuJoCo specification, at the room's origin with all joints at 0.

    Bodies `robot` (the base frame) to `gripper_link` and the fingers; joints and actuators
    as in `perdure.home.sim.robot.JOINTS`; site `gripper` at the gripper point; cameras `head` and `hand`; geoms
    `robot/...`.
    The base's actuators take velocities along the room's axes in [m/s] and [rad/s], all others positions in [m] or
    [rad]. Gravity is compensated in every body: the servos carry only what the robot lifts. The servos are made for the
    integrator `implicitfast` and steps of at most 1/120 s; options are left alone.

    Args:
        spec: Where to add it.
        visuals: Whether visual geometry is built; without it the colliding shapes are visible.
    """
    base = spec.worldbody.add_body(name="robot", gravcomp=1.0)
    _set_inertia(base, combined(_FETCH.base))
    axes = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
    for name, kind, axis in zip(BASE_JOINTS, ("slide", "slide", "hinge"), axes, strict=True):
        add_joint(spec, base, name, kind, axis, None)
    bodies = {"robot": base}
    for link in (TORSO, *ARM):
        _add_link(spec, bodies, link)
    _add_gripper(bodies)
    for link in FINGERS:
        _add_link(spec, bodies, link)
    for shape in _FETCH.shapes:
        _add_shape(bodies[shape.body], shape, ONLY_COLLIDES if visuals else COLLIDES_AND_SEEN)
    _add_cameras(bodies)
    if visuals:
        _add_visuals(bodies)
    add_servos(spec)


def _add_link(spec: Any, bodies: dict[str, Any], link: Link) -> None:
    """Add one link, its inertia and its joint under its parent, and notes its body in `bodies`."""
    body = bodies[link.parent].add_body(name=link.body, pos=link.origin, gravcomp=1.0)
    _set_inertia(body, combined(link.parts))
    add_joint(spec, body, link.joint, link.kind, link.axis, link.limit).armature = link.armature
    bodies[link.body] = body


def _add_gripper(bodies: dict[str, Any]) -> None:
    """Add the body `gripper_link` behind the wrist, with the site `gripper` at the gripper point."""
    gripper = bodies[ARM[-1].body].add_body(name="gripper_link", pos=GRIPPER_ORIGIN, gravcomp=1.0)
    _set_inertia(gripper, combined((_FETCH.gripper,)))
    gripper.add_site(name="gripper", pos=GRIPPER_POINT, size=(0.01, 0.01, 0.01), group=HIDDEN)
    bodies["gripper_link"] = gripper


def _set_inertia(body: Any, inertial: Inertial) -> None:
    body.mass, body.ipos, body.fullinertia = inertial.mass, inertial.center, inertial.moments
    body.explicitinertial = True


def _add_shape(body: Any, shape: CollisionShape, group: int) -> None:
    contype, conaffinity = BITS[shape.part_of]
    along_x = (math.sqrt(0.5), 0.0, math.sqrt(0.5), 0.0)
    body.add_geom(
        name=f"robot/{shape.name}",
        type=geom_type(shape.kind),
        pos=shape.center,
        quat=along_x if shape.kind == "capsule" else (1.0, 0.0, 0.0, 0.0),
        size=shape.half,
        contype=contype,
        conaffinity=conaffinity,
        friction=FRICTION,
        rgba=(0.85, 0.86, 0.87, 1.0),
        group=group,
        mass=0.0,
    )


def _add_visuals(bodies: dict[str, Any]) -> None:
    drawn = read_json((_DATA / "fetch_visuals.json").read_bytes(), dict[str, list[Visual]])
    for body, visuals in drawn.items():
        for visual in visuals:
            bodies[body].add_geom(
                type=geom_type(visual.kind),
                pos=visual.center,
                quat=visual.quaternion,
                size=visual.half,
                rgba=_FETCH.colors[visual.color],
                group=ONLY_SEEN,
                contype=0,
                conaffinity=0,
                mass=0.0,
            )


def _add_cameras(bodies: dict[str, Any]) -> None:
    gripper, torso = bodies["gripper_link"], bodies[TORSO.body]
    gripper.add_camera(name="hand", pos=HAND_CAMERA, quat=camera_quaternion((1.0, 0.0, 0.0)), fovy=90.0)
    forward = np.subtract(HEAD_LOOKS_AT, HEAD_CAMERA)
    torso.add_camera(name="head", pos=HEAD_CAMERA, quat=camera_quaternion(forward), fovy=90.0)
