"""The Fetch as MJCF: a base that slides on the floor, a torso that lifts, an arm of seven joints, two fingers.

Nothing but primitives: eleven that collide and, with `visuals`, more for pictures.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from perdure.home.sim.arrays import Vec3
from perdure.home.sim.robot.links import (
    ARM,
    BASE_PARTS,
    FINGERS,
    GRIPPER_ORIGIN,
    GRIPPER_PARTS,
    GRIPPER_POINT,
    TORSO,
    Inertial,
    Link,
    combined,
)
from perdure.home.sim.robot.servos import ARMATURE, add_servos
from perdure.home.sim.robot.shapes import BITS, SHAPES, CollisionShape
from perdure.home.sim.robot.visuals import add_visuals

if TYPE_CHECKING:
    import mujoco

SEEN, ONLY_COLLIDES, HIDDEN = 0, 3, 4
"""Geom groups, as in `perdure.home.sim.apartments.build`."""
FRICTION = (0.2, 0.005, 0.0001)
"""As furniture: MuJoCo uses the larger friction of a pair, the object's; a held object is attached by a constraint."""
HEAD_CAMERA: Vec3 = (0.256875, 0.0, 0.67257)
"""In the torso's frame: with the torso at 0.15 m M3's (0.17, 0, 1.2) in the base frame."""
HEAD_LOOKS_AT: Vec3 = (0.836875, 0.0, 0.47257)
"""The same for M3's (0.75, 0, 1.0)."""
HAND_CAMERA: Vec3 = (0.0, 0.0, 0.1)
"""In the frame of `gripper_link`; it looks along the gripper's x (M3)."""


def add_fetch(spec: mujoco.MjSpec, *, visuals: bool = True) -> None:
    """Add the robot to a MuJoCo specification, at the room's origin with all joints at 0.

    Bodies `robot` (the base frame) to `gripper_link` and the fingers; joints and actuators
    as in `perdure.home.sim.robot.data.JOINTS`; site `gripper` at the gripper point; cameras `head` and `hand`; geoms
    `robot/...`.
    The base's actuators take velocities along the room's axes in [m/s] and [rad/s], all others positions in [m] or
    [rad]. Gravity is compensated in every body: the servos carry only what the robot lifts. The servos are made for the
    integrator `implicitfast` and steps of at most 1/120 s; options are left alone.

    Args:
        spec: Where to add it.
        visuals: Whether visual geometry is built; without it the colliding shapes are visible.
    """
    base = spec.worldbody.add_body(name="robot", gravcomp=1.0)
    _set_inertia(base, combined(BASE_PARTS))
    _add_joint(spec, base, "base_x", "slide", (1.0, 0.0, 0.0), None)
    _add_joint(spec, base, "base_y", "slide", (0.0, 1.0, 0.0), None)
    _add_joint(spec, base, "base_yaw", "hinge", (0.0, 0.0, 1.0), None)
    bodies = {"robot": base}
    for link in (TORSO, *ARM):
        add_link(spec, bodies, link)
    add_gripper(bodies)
    for link in FINGERS:
        add_link(spec, bodies, link)
    for shape in SHAPES:
        _add_shape(bodies[shape.body], shape, ONLY_COLLIDES if visuals else SEEN)
    _add_cameras(bodies)
    if visuals:
        add_visuals(bodies)
    add_servos(spec)


def add_link(spec: Any, bodies: dict[str, Any], link: Link) -> None:
    """Add one link, its inertia and its joint under its parent, and notes its body in `bodies`."""
    body = bodies[link.parent].add_body(name=link.body, pos=link.origin, gravcomp=1.0)
    _set_inertia(body, combined(link.parts))
    _add_joint(spec, body, link.joint, link.kind, link.axis, link.limit)
    bodies[link.body] = body


def add_gripper(bodies: dict[str, Any]) -> None:
    """Add the body `gripper_link` behind the wrist, with the site `gripper` at the gripper point."""
    gripper = bodies[ARM[-1].body].add_body(name="gripper_link", pos=GRIPPER_ORIGIN, gravcomp=1.0)
    _set_inertia(gripper, combined(GRIPPER_PARTS))
    gripper.add_site(name="gripper", pos=GRIPPER_POINT, size=(0.01, 0.01, 0.01), group=HIDDEN)
    bodies["gripper_link"] = gripper


def _set_inertia(body: Any, inertial: Inertial) -> None:
    body.mass, body.ipos, body.fullinertia = inertial.mass, inertial.center, inertial.moments
    body.explicitinertial = True


def _add_joint(spec: Any, body: Any, name: str, kind: str, axis: Vec3, limit: tuple[float, float] | None) -> None:
    import mujoco

    hinge = kind == "hinge"
    joint = body.add_joint(
        name=name,
        type=mujoco.mjtJoint.mjJNT_HINGE if hinge else mujoco.mjtJoint.mjJNT_SLIDE,
        axis=axis,
        armature=ARMATURE.get(name, 0.0),
        limited=mujoco.mjtLimited.mjLIMITED_FALSE if limit is None else mujoco.mjtLimited.mjLIMITED_TRUE,
    )
    if limit is not None:
        joint.range = np.degrees(limit) if hinge and spec.compiler.degree else limit


def _add_shape(body: Any, shape: CollisionShape, group: int) -> None:
    import mujoco

    contype, conaffinity = BITS[shape.side]
    along_x = (math.sqrt(0.5), 0.0, math.sqrt(0.5), 0.0)
    body.add_geom(
        name=f"robot/{shape.name}",
        type=getattr(mujoco.mjtGeom, f"mjGEOM_{shape.kind.upper()}"),
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


def _add_cameras(bodies: dict[str, Any]) -> None:
    gripper, torso = bodies["gripper_link"], bodies[TORSO.body]
    gripper.add_camera(name="hand", pos=HAND_CAMERA, quat=_looking((1.0, 0.0, 0.0)), fovy=90.0)
    forward = np.subtract(HEAD_LOOKS_AT, HEAD_CAMERA)
    torso.add_camera(name="head", pos=HEAD_CAMERA, quat=_looking(forward), fovy=90.0)


def _looking(forward: Any) -> np.ndarray:
    """Return orientation of a camera that looks along a direction in the body's xz plane, the picture upright."""
    import mujoco

    x, _, z = np.asarray(forward) / np.linalg.norm(forward)
    columns = np.array([(0.0, -1.0, 0.0), (-z, 0.0, x), (-x, 0.0, -z)]).T  # right, up, backward
    quat = np.empty(4)
    mujoco.mju_mat2Quat(quat, columns.ravel())
    return quat
