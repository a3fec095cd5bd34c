"""Inverse kinematics for many wanted gripper poses at once: damped least squares, all candidates side by side.

The oracle weighs hundreds of ways to hold the arm before each motion; `perdure.home.sim.robot.inverse.reach` finds one
pose more exactly, but in 20 ms, this some hundred in the same time.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from perdure.home.sim.robot.data import ARM_HIGH, ARM_LOW, TORSO_HEIGHT
from perdure.home.sim.robot.kinematics import pose_and_jacobian
from perdure.home.sim.robot.toward import rotation_vector

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

DAMPING = 0.05
FARTHEST_M, FARTHEST_RAD, FARTHEST_STEP = 0.15, 0.5, 0.3
"""Largest error that one iteration looks at, and its largest joint step."""


def reach_many(
    points: FloatArray, approach: FloatArray, upright: bool, start: FloatArray, iterations: int = 25
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Arm poses that bring the gripper to places in the base frame.

    Args:
        points: Where the gripper point should be in [m]. Shape (n, 3).
        approach: Where the gripper's x axis should point, of length 1. Shape (n, 3).
        upright: Whether its z axis must point up; else the roll about x is free.
        start: Where the search starts. Shape (n, 7) or (7,).
        iterations: How many steps are made.

    Returns:
        Joint angles (n, 7), what is left of the way in [m] (n,) and of the turn in [rad] (n,).
    """
    arm = np.broadcast_to(start, (len(points), 7)).copy()
    wanted = _upright(approach) if upright else None
    for _ in range(iterations):
        position, rotation, matrix = pose_and_jacobian(TORSO_HEIGHT, arm)
        way = points - position
        turn = _turn(rotation, approach, wanted)
        if wanted is None:  # rolling about the x axis neither helps nor harms
            x = rotation[..., :, 0]
            matrix = matrix.copy()
            matrix[:, 3:] -= x[:, :, None] * np.einsum("ni,nij->nj", x, matrix[:, 3:])[:, None, :]
        error = np.concatenate([_shorten(way, FARTHEST_M), _shorten(turn, FARTHEST_RAD)], axis=1)
        square = matrix @ matrix.swapaxes(1, 2) + DAMPING**2 * np.eye(6)
        step = (matrix.swapaxes(1, 2) @ np.linalg.solve(square, error[..., None]))[..., 0]
        arm = np.clip(arm + _largest(step), ARM_LOW, ARM_HIGH)
    position, rotation, _ = pose_and_jacobian(TORSO_HEIGHT, arm)
    left = np.linalg.norm(points - position, axis=1)
    return arm, left, np.linalg.norm(_turn(rotation, approach, wanted), axis=1)


def _turn(rotation: FloatArray, approach: FloatArray, wanted: FloatArray | None) -> FloatArray:
    """Rotation vectors to the wanted rotation, or the shortest ones to the wanted x axis. Shape (n, 3)."""
    if wanted is not None:
        return rotation_vector(rotation, wanted)
    x = rotation[..., :, 0]
    axis = np.cross(x, approach)
    sine = np.linalg.norm(axis, axis=1, keepdims=True)
    cosine = (x * approach).sum(axis=1, keepdims=True)
    vector: FloatArray = axis / np.maximum(sine, 1e-9) * np.arctan2(sine, cosine)
    return vector


def _upright(approach: FloatArray) -> FloatArray:
    """Rotations whose x axis is a level approach and whose z axis points up. Shape (n, 3, 3)."""
    up = np.broadcast_to((0.0, 0.0, 1.0), approach.shape)
    return np.stack([approach, np.cross(up, approach), up], axis=-1)


def _shorten(vectors: FloatArray, longest: float) -> FloatArray:
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    short: FloatArray = vectors * np.minimum(1.0, longest / np.maximum(length, 1e-12))
    return short


def _largest(steps: FloatArray) -> FloatArray:
    size = np.abs(steps).max(axis=1, keepdims=True)
    small: FloatArray = steps * np.minimum(1.0, FARTHEST_STEP / np.maximum(size, 1e-12))
    return small
