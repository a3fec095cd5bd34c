"""Where the gripper is, from joint angles alone: exact, without a simulator, for many robots at once.

Base frame: x forward, y left, z up, the origin on the floor under `base_link`. The chain is the URDF's: each joint's
frame is displaced by a constant and then turned about one of its own axes, so a turn only mixes two columns of the
rotation matrix.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from perdure.home.errors import HomeError
from perdure.home.sim.arrays import FloatArray
from perdure.home.sim.robot.links import ARM, GRIPPER_ORIGIN, GRIPPER_POINT, TORSO

_AXES = tuple(link.axis.index(1.0) for link in ARM)
_OFFSETS = np.array([link.origin for link in ARM])
_LAST = np.array(GRIPPER_ORIGIN) + np.array(GRIPPER_POINT)


def gripper_pose(torso: ArrayLike, arm: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Return the gripper point in the base frame.

    Args:
        torso: Height of the torso in [m]. Shape (...) or one number for all.
        arm: Joint angles in [rad]. Shape (..., 7).

    Returns:
        Position in [m], shape (..., 3), and rotation, shape (..., 3, 3), whose columns are the gripper's axes (x is
        where the fingers point). Equal to the model's site `gripper` seen from body `robot`.
    """
    position, rotation, _, _ = _chain(torso, arm)
    return position, rotation


def pose_and_jacobian(torso: ArrayLike, arm: ArrayLike) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the results of `gripper_pose`, and the Jacobian: rows are velocity in [m/rad], then angular velocity.

    The geometric Jacobian in the base frame, shape (..., 6, 7): column i is (a_i x (p - o_i), a_i) with the joint's
    axis a_i and origin o_i (Siciliano et al., *Robotics*, 2009, section 3.1.3).
    """
    position, rotation, origins, axes = _chain(torso, arm)
    away = position[..., None, :] - origins
    columns = np.empty((*position.shape[:-1], 6, 7))
    for row, (first, second) in enumerate(((1, 2), (2, 0), (0, 1))):
        columns[..., row, :] = axes[..., first] * away[..., second] - axes[..., second] * away[..., first]
        columns[..., 3 + row, :] = axes[..., row]
    return position, rotation, columns


def _chain(torso: ArrayLike, arm: ArrayLike) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return position and rotation of the gripper, origins and axes of the joints (both (..., 7, 3))."""
    angles = np.asarray(arm, dtype=np.float64)
    if angles.shape[-1:] != (7,):
        raise HomeError(f"arm angles must have shape (..., 7), got {angles.shape}")
    batch = np.broadcast_shapes(angles.shape[:-1], np.shape(torso))
    position = np.broadcast_to(np.array(TORSO.origin), (*batch, 3)).copy()
    position[..., 2] += np.asarray(torso, dtype=np.float64)
    rotation = np.broadcast_to(np.eye(3), (*batch, 3, 3)).copy()
    cos, sin = np.cos(angles), np.sin(angles)
    origins, axes = np.empty((*batch, 7, 3)), np.empty((*batch, 7, 3))
    for i, axis in enumerate(_AXES):
        position += rotation @ _OFFSETS[i]
        origins[..., i, :], axes[..., i, :] = position, rotation[..., :, axis]
        _turn(rotation, axis, cos[..., i, None], sin[..., i, None])
    return position + rotation @ _LAST, rotation, origins, axes


def _turn(rotation: FloatArray, axis: int, cos: FloatArray, sin: FloatArray) -> None:
    """Turn frames about one of their own axes, in place."""
    first, second = (axis + 1) % 3, (axis + 2) % 3
    u, v = rotation[..., :, first].copy(), rotation[..., :, second].copy()
    rotation[..., :, first] = cos * u + sin * v
    rotation[..., :, second] = cos * v - sin * u
