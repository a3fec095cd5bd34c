"""One small step of the gripper in a straight line: damped least squares, for many robots at once.

A step dq = W J^T (J W J^T + d^2 I)^-1 e (Nakamura and Hanafusa, 1986) moves the gripper by e = (displacement, rotation
vector) and stays bounded where the arm is stretched out. W takes joints out whose step would cross a limit; they go
to the limit and the others do the rest.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from perdure.home.errors import HomeError
from perdure.home.sim.robot.data import ARM_HIGH, ARM_LOW, TORSO_HEIGHT
from perdure.home.sim.robot.kinematics import pose_and_jacobian
from perdure.home.sim.robot.links import FloatArray

DAMPING = 0.01
"""OURS: d; the error it leaves is d^2 / s^2, under 1 % where the arm moves the gripper by s > 0.1 m per radian."""
TURN_WEIGHT = 0.3
"""OURS: a radian counts like so many meters where both cannot be had: the place matters more than the rotation."""
LARGEST = 0.025
"""Of a joint's step in [rad]: the benchmark's largest command."""


def toward(
    arm: ArrayLike,
    displacement: ArrayLike,
    *,
    rotation: ArrayLike | None = None,
    torso: ArrayLike = TORSO_HEIGHT,
    largest: float = LARGEST,
) -> FloatArray:
    """Joint steps that move the gripper point straight on and keep its rotation.

    Args:
        arm: Joint angles in [rad]. Shape (..., 7).
        displacement: Wanted motion of the gripper point in the base frame in [m]. Shape (..., 3).
        rotation: Rotation to turn towards (or to come back to, over many steps), None to keep the present one. Shape
            (..., 3, 3).
        torso: Height of the torso in [m]. Shape (...) or one number.
        largest: No joint moves farther in [rad]: a step that wants more is shortened as a whole, its direction kept.

    Returns:
        Steps in [rad] to add to `arm`; the sum keeps the limits if `arm` does. Shape (..., 7).

    Raises:
        HomeError: When `arm` or `displacement` has a wrong shape or `largest` is not positive.
    """
    angles, move = np.asarray(arm, dtype=np.float64), np.asarray(displacement, dtype=np.float64)
    if move.shape[-1:] != (3,):
        raise HomeError(f"displacement must have shape (..., 3), got {move.shape}")
    if not largest > 0.0:
        raise HomeError(f"largest must be positive, got {largest}")
    _, now, matrix = pose_and_jacobian(torso, angles)
    turn = np.zeros(3) if rotation is None else rotation_vector(now, rotation)
    batch = np.broadcast_shapes(matrix.shape[:-2], move.shape[:-1], turn.shape[:-1])
    motion = np.concatenate([np.broadcast_to(move, (*batch, 3)), np.broadcast_to(turn, (*batch, 3))], axis=-1)
    angles = np.broadcast_to(angles, (*batch, 7))
    weights = np.array([1.0] * 3 + [TURN_WEIGHT] * 3)
    step = _within_limits(weights[:, None] * matrix, angles, weights * motion)
    size = np.max(np.abs(step), axis=-1, keepdims=True)
    short: FloatArray = step * np.minimum(1.0, largest / np.maximum(size, 1e-12))
    return short


def _within_limits(matrix: FloatArray, angles: FloatArray, motion: FloatArray) -> FloatArray:
    """The step that makes the motion as well as the limits allow."""
    step, free = np.zeros_like(angles), np.ones_like(angles)
    for _ in range(4):  # at most three joints reach their limits in one step, as a rule; the last clip is always made
        rest = motion - (matrix @ (step * (1.0 - free))[..., None])[..., 0]
        wanted = np.where(free > 0.0, _least_squares(matrix, free, rest), step)
        step = np.clip(angles + wanted, ARM_LOW, ARM_HIGH) - angles
        crossed = np.abs(step - wanted) > 1e-12
        if not np.any(crossed):
            break
        free = np.where(crossed, 0.0, free)
    return step


def rotation_vector(start: ArrayLike, end: ArrayLike) -> FloatArray:
    """The turn from one rotation to another: its axis times its angle in [rad]. Shapes (..., 3, 3) to (..., 3).

    Close to half a turn the axis is lost in rounding; the angle is not, unless it is exact to the last bit.
    """
    turn = np.asarray(end, dtype=np.float64) @ np.swapaxes(np.asarray(start, dtype=np.float64), -1, -2)
    twice_sine = np.stack(
        [
            turn[..., 2, 1] - turn[..., 1, 2],
            turn[..., 0, 2] - turn[..., 2, 0],
            turn[..., 1, 0] - turn[..., 0, 1],
        ],
        axis=-1,
    )
    sine = 0.5 * np.linalg.norm(twice_sine, axis=-1, keepdims=True)
    cosine = 0.5 * (np.trace(turn, axis1=-2, axis2=-1)[..., None] - 1.0)
    vector: FloatArray = 0.5 * twice_sine * np.arctan2(sine, cosine) / np.maximum(sine, 1e-12)
    return vector


def _least_squares(matrix: FloatArray, free: FloatArray, motion: FloatArray) -> FloatArray:
    """The damped step of the free joints (free: 1, else 0)."""
    used = matrix * free[..., None, :]
    square = used @ np.swapaxes(matrix, -1, -2) + DAMPING**2 * np.eye(6)
    step: FloatArray = (np.swapaxes(used, -1, -2) @ np.linalg.solve(square, motion[..., None]))[..., 0]
    return step
