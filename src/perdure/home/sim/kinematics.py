"""Where the gripper is, from joint angles alone: exact, without a simulator, for many robots at once.

Base frame: x forward, y left, z up, the origin on the floor under the base. The chain is the URDF's: each joint's
frame is displaced by a constant and then turned about one of its own axes, so a turn only mixes two columns of the
rotation matrix.

Every solver here repeats the step dq = W J^T (J W J^T + d^2 I)^-1 e (Nakamura and Hanafusa, 1986), which stays bounded
where the arm is stretched out. e is the error of the gripper as (displacement, rotation vector). W is 1 for joints that
may move and 0 for joints at a limit. Base and torso stand still.

| function | for | joint limits | accuracy |
|---|---|---|---|
| `toward` | one small step of a straight motion | free joints make up for joints at a limit | one step |
| `reach_many` | hundreds of candidate poses | clipped | centimeters |
| `reach` | one pose | free joints make up for joints at a limit | 0.1 mm |
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from perdure.errors import PerdureError
from perdure.home.sim.arrays import FloatArray
from perdure.home.sim.pieces import Pose
from perdure.home.sim.robot import ROBOT

_JOINTS = len(ROBOT.arm)
_AXES = tuple(joint.axis.index(1.0) for joint in ROBOT.arm)
"""The axis of each joint: 0 for x, 1 for y, 2 for z of its own frame."""
_OFFSETS = np.array([joint.origin for joint in ROBOT.arm])
_GRIPPER_POINT = np.array(ROBOT.gripper_point)


def gripper_pose(torso: ArrayLike, arm: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Return the gripper point in the base frame.

    Args:
        torso: Height of the torso in [m]. Shape (...) or one number for all.
        arm: Joint angles in [rad]. Shape (..., joints).

    Returns:
        Position in [m], shape (..., 3), and rotation, shape (..., 3, 3), whose columns are the gripper's axes (x is
        where the fingers point). Equal to the model's gripper site seen from the base.
    """
    return _chain(torso, arm)[:2]


def gripper_in_room(base: Pose, arm: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return where the gripper would be in the room: position (3,) and rotation (3, 3)."""
    position, rotation = gripper_pose(ROBOT.torso_height, arm)
    return base.to_room(position), about_z(base.yaw) @ rotation


def about_z(angle: float) -> FloatArray:
    """Return the rotation by an angle in [rad] about the vertical. Shape (3, 3)."""
    cos = np.cos(angle)
    sin = np.sin(angle)
    return np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])


def pose_and_jacobian(torso: ArrayLike, arm: ArrayLike) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the results of `gripper_pose`, and the Jacobian: rows are velocity in [m/rad], then angular velocity.

    The geometric Jacobian in the base frame, shape (..., 6, joints): column i is (a_i x (p - o_i), a_i) with the
    joint's axis a_i and origin o_i (Siciliano et al., *Robotics*, 2009, section 3.1.3).
    """
    position, rotation, origins, axes = _chain(torso, arm)
    away = position[..., None, :] - origins
    columns = np.empty((*position.shape[:-1], 6, _JOINTS))
    # The cross product, row by row: each one needs the two other coordinates.
    for row in range(3):
        first = (row + 1) % 3
        second = (row + 2) % 3
        columns[..., row, :] = axes[..., first] * away[..., second] - axes[..., second] * away[..., first]
        columns[..., 3 + row, :] = axes[..., row]
    return position, rotation, columns


def _chain(torso: ArrayLike, arm: ArrayLike) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return position and rotation of the gripper, origins and axes of the joints (both (..., joints, 3))."""
    angles = np.asarray(arm, dtype=np.float64)
    if angles.shape[-1:] != (_JOINTS,):
        raise PerdureError(f"arm angles must have shape (..., {_JOINTS}), got {angles.shape}")
    batch = np.broadcast_shapes(angles.shape[:-1], np.shape(torso))
    position = np.broadcast_to(np.array(ROBOT.torso.origin), (*batch, 3)).copy()
    position[..., 2] += np.asarray(torso, dtype=np.float64)
    rotation = np.broadcast_to(np.eye(3), (*batch, 3, 3)).copy()
    cos = np.cos(angles)
    sin = np.sin(angles)
    origins = np.empty((*batch, _JOINTS, 3))
    axes = np.empty((*batch, _JOINTS, 3))
    for i, axis in enumerate(_AXES):
        position += rotation @ _OFFSETS[i]
        origins[..., i, :] = position
        axes[..., i, :] = rotation[..., :, axis]
        _turn(rotation, axis, cos[..., i, None], sin[..., i, None])
    return position + rotation @ _GRIPPER_POINT, rotation, origins, axes


def _turn(rotation: FloatArray, axis: int, cos: FloatArray, sin: FloatArray) -> None:
    """Turn frames about one of their own axes, in place."""
    first = (axis + 1) % 3
    second = (axis + 2) % 3
    u = rotation[..., :, first].copy()
    v = rotation[..., :, second].copy()
    rotation[..., :, first] = cos * u + sin * v
    rotation[..., :, second] = cos * v - sin * u


LARGEST = 0.025
"""Largest joint step of `toward` in [rad]: the benchmark's largest command."""
CLOSE_M = 1e-4
CLOSE_RAD = 1e-3
"""Errors of `reach` below which a pose counts as reached."""
TOWARD_DAMPING = 0.01
REACH_DAMPING = 1e-3
MANY_DAMPING = 0.05
"""d of each solver (our choice, as all that follows)."""
DAMPING_PER_ERROR = 0.03
"""What `reach` adds to d, in squares: this share of the norm of the weighted error (Sugihara, 2011)."""
TOWARD_TURN = 0.3
REACH_TURN = 0.5
"""Meters that a radian of the gripper weighs as much as."""
REACH_LARGEST = 0.4
MANY_LARGEST = 0.3
"""Largest joint step of one iteration in [rad]."""
MANY_LONGEST = 0.15
"""Largest displacement in [m] that one iteration of `reach_many` asks for."""
MANY_TURN = 0.5
"""Largest turn in [rad] that one iteration of `reach_many` asks for."""


def toward(
    arm: ArrayLike,
    displacement: ArrayLike,
    *,
    rotation: ArrayLike | None = None,
    largest: float = LARGEST,
) -> FloatArray:
    """Return joint steps that move the gripper point by a small displacement and keep its rotation.

    Args:
        arm: Joint angles in [rad]. Shape (..., joints).
        displacement: Wanted motion of the gripper point in the base frame in [m]. Shape (..., 3).
        rotation: Rotation to turn to (or to return to, over many steps); None keeps the present one. Shape (..., 3, 3).
        largest: Largest joint step in [rad]. A longer step is shortened as a whole; its direction is kept.

    Returns:
        Steps in [rad] to add to `arm`; the sum keeps the limits if `arm` does. Shape (..., joints).

    Raises:
        PerdureError: When `arm` or `displacement` has a wrong shape or `largest` is not positive.
    """
    angles = np.asarray(arm, dtype=np.float64)
    move = np.asarray(displacement, dtype=np.float64)
    if move.shape[-1:] != (3,):
        raise PerdureError(f"displacement must have shape (..., 3), got {move.shape}")
    if not largest > 0.0:
        raise PerdureError(f"largest must be positive, got {largest}")
    _, now, matrix = pose_and_jacobian(ROBOT.torso_height, angles)
    turn = np.zeros(3)
    if rotation is not None:
        turn = rotation_vector(now, rotation)
    batch = np.broadcast_shapes(matrix.shape[:-2], move.shape[:-1], turn.shape[:-1])
    motion = np.concatenate([np.broadcast_to(move, (*batch, 3)), np.broadcast_to(turn, (*batch, 3))], axis=-1)
    step = _step_within_limits(matrix, motion, np.broadcast_to(angles, (*batch, _JOINTS)), TOWARD_TURN, TOWARD_DAMPING)
    return _shorten(step, np.max(np.abs(step), axis=-1, keepdims=True), largest)


def reach_many(
    points: FloatArray, approach: FloatArray, axes: FloatArray | None, start: FloatArray, iterations: int = 25
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return arm poses that bring the gripper to many places, about a hundred in the time `reach` needs for one.

    Args:
        points: Wanted gripper points in the base frame in [m]. Shape (n, 3).
        approach: Wanted directions of the gripper's x axis, of length 1. Shape (n, 3).
        axes: Wanted axes of the gripper, one per column, the first of them its approach; None when the roll about x is
            free. Shape (n, 3, 3).
        start: Where the search starts. Shape (n, joints) or (joints,).
        iterations: Number of steps.

    Returns:
        Joint angles (n, joints), remaining distance in [m] (n,) and remaining turn in [rad] (n,).
    """
    arm = np.broadcast_to(start, (len(points), _JOINTS)).copy()
    for _ in range(iterations):
        way, turn, matrix = _error(points, axes, approach, arm)
        way = _shorten(way, _length(way), MANY_LONGEST)
        turn = _shorten(turn, _length(turn), MANY_TURN)
        step = damped_step(matrix, np.concatenate([way, turn], axis=1), MANY_DAMPING)
        arm = np.clip(
            arm + _shorten(step, np.abs(step).max(axis=1, keepdims=True), MANY_LARGEST), ROBOT.arm_low, ROBOT.arm_high
        )
    way, turn, _ = _error(points, axes, approach, arm)
    return arm, np.linalg.norm(way, axis=1), np.linalg.norm(turn, axis=1)


def reach(position: FloatArray, rotation: FloatArray, start: FloatArray) -> tuple[FloatArray, float, float]:
    """Return the arm pose nearest to a pose of the gripper on a descent of at most 60 steps.

    Args:
        position: Wanted gripper point in the base frame in [m]. Shape (3,).
        rotation: Wanted rotation of the gripper. Shape (3, 3).
        start: Joint angles where the search starts in [rad]. Shape (joints,).

    Returns:
        Joint angles (joints,), remaining distance in [m] and remaining turn in [rad].
    """
    arm = np.clip(start, ROBOT.arm_low, ROBOT.arm_high)[None]
    best = arm
    errors = np.full(2, np.inf)
    for _ in range(61):
        way, turn, matrix = _error(position, rotation, rotation[:, 0], arm)
        now = np.concatenate([_length(way), _length(turn)], axis=1)[0]
        if now @ (1.0, REACH_TURN) < errors @ (1.0, REACH_TURN):
            best = arm
            errors = now
        if (errors <= (0.1 * CLOSE_M, 0.1 * CLOSE_RAD)).all():
            break
        motion = np.concatenate([way, turn], axis=1)
        step = _step_within_limits(matrix, motion, arm, REACH_TURN, REACH_DAMPING, DAMPING_PER_ERROR)
        arm = arm + _shorten(step, np.abs(step).max(axis=1, keepdims=True), REACH_LARGEST)
    return best[0], float(errors[0]), float(errors[1])


def damped_step(
    matrix: FloatArray, error: FloatArray, damping: float | FloatArray, free: FloatArray | None = None
) -> FloatArray:
    """Return the damped least squares step W J^T (J W J^T + d^2 I)^-1 e.

    Args:
        matrix: Jacobian J. Shape (..., m, n).
        error: e. Shape (..., m).
        damping: d, one number or shape (...).
        free: Diagonal of W: 1 for joints that may move, else 0; None for all. Shape (..., n).

    Returns:
        Shape (..., n).
    """
    used = matrix
    if free is not None:
        used = matrix * free[..., None, :]
    square = used @ np.swapaxes(matrix, -1, -2) + np.asarray(damping**2)[..., None, None] * np.eye(matrix.shape[-2])
    return (np.swapaxes(used, -1, -2) @ np.linalg.solve(square, error[..., None]))[..., 0]


def damped_inverse(matrix: FloatArray, damping: float) -> FloatArray:
    """Return the damped pseudoinverse J^T (J J^T + d^2 I)^-1 of one Jacobian. Shape (m, n) -> (n, m)."""
    return matrix.T @ np.linalg.inv(matrix @ matrix.T + damping**2 * np.eye(len(matrix)))


def rotation_vector(start: ArrayLike, end: ArrayLike) -> FloatArray:
    """Return the turn from one rotation to another: its axis times its angle in [rad]. Shapes (..., 3, 3) to (..., 3).

    Close to half a turn the axis is lost in rounding; the angle is not, unless it is exact to the last bit.
    """
    turn = np.asarray(end, dtype=np.float64) @ np.swapaxes(np.asarray(start, dtype=np.float64), -1, -2)
    pairs = ((2, 1), (0, 2), (1, 0))
    twice_sine = np.stack([turn[..., i, j] - turn[..., j, i] for i, j in pairs], axis=-1)
    sine = 0.5 * np.linalg.norm(twice_sine, axis=-1, keepdims=True)
    cosine = 0.5 * (np.trace(turn, axis1=-2, axis2=-1)[..., None] - 1.0)
    return np.asarray(0.5 * twice_sine * np.arctan2(sine, cosine) / np.maximum(sine, 1e-12))


def _step_within_limits(
    matrix: FloatArray, motion: FloatArray, angles: FloatArray, turn_weight: float, least: float, per_error: float = 0.0
) -> FloatArray:
    """Return the step that makes the motion as well as the limits allow; free joints make up for joints at a limit."""
    weights = np.array([1.0] * 3 + [turn_weight] * 3)
    matrix = weights[:, None] * matrix
    motion = weights * motion
    damping = np.hypot(least, per_error * np.linalg.norm(motion, axis=-1))
    step = np.zeros_like(angles)
    free = np.ones_like(angles)
    for _ in range(4):  # at most three joints reach their limits in one step, as a rule; the last clip is always made
        rest = motion - (matrix @ (step * (1.0 - free))[..., None])[..., 0]
        wanted = np.where(free > 0.0, damped_step(matrix, rest, damping, free), step)
        step = np.clip(angles + wanted, ROBOT.arm_low, ROBOT.arm_high) - angles
        crossed = np.abs(step - wanted) > 1e-12
        if not np.any(crossed):
            break
        free = np.where(crossed, 0.0, free)
    return step


def _error(
    place: FloatArray, rotation: FloatArray | None, approach: FloatArray, arm: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return displacement (n, 3), turn (n, 3) and Jacobian (n, 6, joints) to a pose.

    Without a rotation the gripper's x axis turns to `approach`, and rolling about it is free.
    """
    position, now, matrix = pose_and_jacobian(ROBOT.torso_height, arm)
    way = place - position
    if rotation is not None:
        return way, rotation_vector(now, rotation), matrix
    x = now[..., :, 0]
    matrix[:, 3:] -= x[:, :, None] * np.einsum("ni,nij->nj", x, matrix[:, 3:])[:, None, :]
    return way, _turn_x(x, approach), matrix


def _turn_x(x: FloatArray, approach: FloatArray) -> FloatArray:
    """Return the shortest turns from one unit vector to another as rotation vectors. Shape (n, 3)."""
    axis = np.cross(x, approach)
    sine = _length(axis)
    cosine = (x * approach).sum(axis=1, keepdims=True)
    vector: FloatArray = axis / np.maximum(sine, 1e-9) * np.arctan2(sine, cosine)
    opposite = (sine[:, 0] < 1e-9) & (cosine[:, 0] < 0.0)
    if opposite.any():  # half a turn about any axis across
        across = np.cross(x[opposite], np.eye(3)[np.abs(x[opposite]).argmin(axis=1)])
        vector[opposite] = np.pi * across / _length(across)
    return vector


def _length(vectors: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.norm(vectors, axis=1, keepdims=True))


def _shorten(vectors: FloatArray, size: FloatArray, largest: float) -> FloatArray:
    """Return vectors scaled down so that their size is at most `largest`."""
    return vectors * np.minimum(1.0, largest / np.maximum(size, 1e-12))
