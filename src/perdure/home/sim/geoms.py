"""What the models of robot, apartments and objects have in common: geom groups, collision bits, joints and cameras."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from perdure.home.sim.arrays import FloatArray, Vec3

COLLIDES_AND_SEEN, WALL, ONLY_SEEN, ONLY_COLLIDES, HIDDEN = range(5)
"""Geom groups. A wall collides and is seen, too; hidden are handles and the robot's bumper."""
ROBOT_BIT, HAND_BIT, BUMPER_BIT, OBJECT_BIT = 1, 2, 4, 8
"""Collision bits: robot against room; hand against the robot's body; base bumper against furniture; object against
object, also while the objects ignore the robot."""
FRICTION = (0.2, 0.005, 0.0001)
"""Friction of furniture and robot: low, because MuJoCo takes the larger one of a pair and the object's is to decide."""


def geom_type(shape: str) -> Any:
    """Return MuJoCo's geom type of a shape's name, such as `box`."""
    import mujoco

    return getattr(mujoco.mjtGeom, f"mjGEOM_{shape.upper()}")


def add_joint(spec: Any, body: Any, name: str, kind: str, axis: Vec3, limit: tuple[float, float] | None) -> Any:
    """Add a `hinge` or a `slide` to a body and return it; the limits are in [rad] or [m], None for none."""
    import mujoco

    hinge = kind == "hinge"
    joint = body.add_joint(
        name=name,
        type=mujoco.mjtJoint.mjJNT_HINGE if hinge else mujoco.mjtJoint.mjJNT_SLIDE,
        axis=axis,
        limited=mujoco.mjtLimited.mjLIMITED_FALSE if limit is None else mujoco.mjtLimited.mjLIMITED_TRUE,
    )
    if limit is not None:
        joint.range = np.degrees(limit) if hinge and spec.compiler.degree else limit
    return joint


def camera_quaternion(forward: ArrayLike) -> FloatArray:
    """Return the orientation (w, x, y, z) of a camera that looks along a direction (3,) with a level horizon."""
    import mujoco

    backward = -np.asarray(forward) / np.linalg.norm(forward)
    right = np.cross((0.0, 0.0, 1.0), backward)
    right /= np.linalg.norm(right)
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, np.stack([right, np.cross(backward, right), backward], axis=1).ravel())
    return quaternion
