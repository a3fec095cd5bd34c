"""Joint angles that bring the gripper to a wanted place: inverse kinematics by quadratic programs (mink).

Each iteration asks for the joint step that best removes the error of the gripper's pose and stays within the limits,
and weakly for the posture it started from, which settles what the pose leaves open. The base and the torso stand still.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from perdure.home.errors import HomeError
from perdure.home.sim.robot.data import REST_ARM, TORSO_HEIGHT
from perdure.home.sim.robot.fetch import add_gripper, add_link
from perdure.home.sim.robot.links import ARM, TORSO, FloatArray
from perdure.home.sim.robot.toward import rotation_vector

CLOSE_M, CLOSE_RAD = 1e-4, 1e-3
"""Errors below which a solution is taken to be one."""
LARGEST_STEP = 0.4
"""Of a joint in one iteration in [rad]: the linearised problem holds no farther."""
TURN_COST, POSTURE_COST = 0.5, 1e-3
"""Of a radian of the gripper and of a joint, against 1 for a meter: posture shifts a solution by a few micrometers."""
OTHER_STARTS = (
    REST_ARM,
    (0.0, 0.6, 0.0, 0.8, 0.0, 0.4, 0.0),
    (0.8, -0.6, 1.2, 1.6, -0.8, 1.2, 1.0),
    (-0.8, -0.6, -1.2, 1.6, 0.8, 1.2, -1.0),
    (0.0, 0.9, 3.0, 1.2, 3.0, 1.2, 0.0),
)
"""OURS: where the search starts anew, in turn, when it got stuck: low and ahead, elbow left, right and down."""

_local = threading.local()


@dataclass(frozen=True)
class Reach:
    """What inverse kinematics found."""

    arm: FloatArray
    """Joint angles in [rad], within the limits. Shape (7,)."""
    position_error: float
    """Distance between gripper point and wanted point in [m]."""
    rotation_error: float
    """Angle to the wanted rotation or approach direction in [rad]; 0 when none was wanted."""

    @property
    def ok(self) -> bool:
        """Whether the gripper gets there: within 0.1 mm and 1 mrad."""
        return self.position_error <= CLOSE_M and self.rotation_error <= CLOSE_RAD

    @property
    def exact(self) -> bool:
        """Whether further search is not worth its time."""
        return self.position_error <= 0.1 * CLOSE_M and self.rotation_error <= 0.1 * CLOSE_RAD

    @property
    def score(self) -> float:
        """Both errors in one number, the smaller the better."""
        return self.position_error + TURN_COST * self.rotation_error


@dataclass(frozen=True)
class _Goal:
    position: FloatArray
    rotation: FloatArray | None
    approach: FloatArray | None

    @property
    def orientation_cost(self) -> list[float]:
        """About the gripper's own axes; the roll about x is free unless a rotation is wanted."""
        if self.rotation is not None:
            return [TURN_COST] * 3
        return [0.0] * 3 if self.approach is None else [0.0, TURN_COST, TURN_COST]

    def target(self, now: FloatArray) -> FloatArray:
        """The wanted rotation; of all that have the wanted approach direction the one nearest to `now`."""
        if self.rotation is not None:
            return self.rotation
        return now if self.approach is None else _carry(now[:, 0], self.approach) @ now

    def errors(self, position: FloatArray, rotation: FloatArray) -> tuple[float, float]:
        far = float(np.linalg.norm(self.position - position))
        if self.rotation is None and self.approach is None:
            return far, 0.0
        return far, float(np.linalg.norm(rotation_vector(rotation, self.target(rotation))))


def reach(
    position: ArrayLike,
    start_arm: ArrayLike,
    *,
    rotation: ArrayLike | None = None,
    approach: ArrayLike | None = None,
    torso: float = TORSO_HEIGHT,
    iterations: int = 40,
    restarts: int = len(OTHER_STARTS),
) -> Reach:
    """Finds joint angles that bring the gripper point to a place in the base frame.

    Args:
        position: Wanted place in [m]. Shape (3,).
        start_arm: Where the search starts in [rad]; of several solutions one near it is found. Shape (7,).
        rotation: Wanted rotation of the gripper. Shape (3, 3).
        approach: Wanted direction of the gripper's x axis, of any length; the roll about it is left open. Shape (3,).
        torso: Height of the torso in [m].
        iterations: Largest number of steps of one search.
        restarts: How many other starts are tried while no solution was found.

    Returns:
        The best angles found. A place out of reach is no error: see `position_error` and `ok`.

    Raises:
        HomeError: When a shape is wrong or both a rotation and an approach are given.
    """
    goal = _goal(position, rotation, approach)
    first = _array("start_arm", start_arm, (7,))
    found: list[Reach] = []
    for start in (first, *(np.array(other) for other in OTHER_STARTS[:restarts])):
        found.append(_search(goal, start, torso, iterations))
        if found[-1].ok:
            return found[-1]
    return min(found, key=lambda one: one.score)


def _search(goal: _Goal, start: FloatArray, torso: float, iterations: int) -> Reach:
    """One descent; keeps the best angles on its way."""
    solver = _solver(torso)
    configuration = solver.configuration
    configuration.update(np.clip(start, *solver.limits))
    solver.posture.set_target(configuration.q)
    solver.frame.set_orientation_cost(goal.orientation_cost)
    best = Reach(configuration.q.copy(), *goal.errors(*solver.pose()))
    for _ in range(iterations):
        step = None if best.exact else _step(solver, goal.position, goal.target(solver.pose()[1]))
        if step is None or np.max(np.abs(step)) < 1e-7:
            break
        configuration.update(configuration.q + step * min(1.0, LARGEST_STEP / np.max(np.abs(step))))
        now = Reach(configuration.q.copy(), *goal.errors(*solver.pose()))
        best = min(best, now, key=lambda one: one.score)
    return best


def _step(solver: _Solver, position: FloatArray, rotation: FloatArray) -> FloatArray | None:
    """The joint step of one quadratic program; None when it has no solution."""
    import mink

    solver.frame.set_target(mink.SE3.from_rotation_and_translation(mink.SO3.from_matrix(rotation), position))
    try:
        velocity = mink.solve_ik(
            solver.configuration, [solver.frame, solver.posture], 1.0, "daqp", 1e-6, limits=[solver.limit]
        )
    except mink.MinkError:
        return None
    step: FloatArray = np.asarray(velocity, dtype=np.float64)
    return step if np.all(np.isfinite(step)) else None


@dataclass(frozen=True)
class _Solver:
    """A model of the arm alone and the tasks on it: MuJoCo's data belongs to one thread."""

    model: Any
    configuration: Any
    frame: Any
    posture: Any
    limit: Any
    limits: tuple[FloatArray, FloatArray]

    def pose(self) -> tuple[FloatArray, FloatArray]:
        """Position and rotation of the gripper point at the configuration."""
        data = self.configuration.data
        return data.site_xpos[0].copy(), data.site_xmat[0].reshape(3, 3).copy()


def _solver(torso: float) -> _Solver:
    """This thread's solver, its torso at the given height."""
    if not hasattr(_local, "solver"):
        _local.solver = _make_solver()
    solver: _Solver = _local.solver
    solver.model.body(TORSO.body).pos[2] = TORSO.origin[2] + torso
    return solver


def _make_solver() -> _Solver:
    import mink
    import mujoco

    spec = mujoco.MjSpec()
    bodies = {TORSO.body: spec.worldbody.add_body(name=TORSO.body, pos=TORSO.origin)}
    for link in ARM:
        add_link(spec, bodies, link)
    add_gripper(bodies)
    model = spec.compile()
    bounded = model.jnt_limited.astype(bool)
    low = np.where(bounded, model.jnt_range[:, 0], -np.inf)
    high = np.where(bounded, model.jnt_range[:, 1], np.inf)
    return _Solver(
        model=model,
        configuration=mink.Configuration(model),
        frame=mink.FrameTask("gripper", "site", position_cost=1.0, orientation_cost=TURN_COST, lm_damping=1e-3),
        posture=mink.PostureTask(model, cost=POSTURE_COST),
        limit=mink.ConfigurationLimit(model, gain=1.0),
        limits=(low, high),
    )


def _goal(position: ArrayLike, rotation: ArrayLike | None, approach: ArrayLike | None) -> _Goal:
    if rotation is not None and approach is not None:
        raise HomeError("reach takes a rotation or an approach direction, not both")
    direction = None if approach is None else _array("approach", approach, (3,))
    if direction is not None:
        length = np.linalg.norm(direction)
        if not length > 0.0:
            raise HomeError(f"approach must have a direction, got {direction.tolist()}")
        direction = direction / length
    turned = None if rotation is None else _array("rotation", rotation, (3, 3))
    return _Goal(_array("position", position, (3,)), turned, direction)


def _array(name: str, values: ArrayLike, shape: tuple[int, ...]) -> FloatArray:
    array = np.array(values, dtype=np.float64)
    if array.shape != shape or not np.all(np.isfinite(array)):
        raise HomeError(f"{name} must be finite numbers of shape {shape}, got {array.tolist()}")
    return array


def _carry(start: FloatArray, end: FloatArray) -> FloatArray:
    """The smallest rotation that carries one unit vector to another (Rodrigues)."""
    axis, cosine = np.cross(start, end), float(start @ end)
    if cosine < -1.0 + 1e-9:  # half a turn about any axis across
        across = np.cross(start, np.eye(3)[np.argmin(np.abs(start))])
        across /= np.linalg.norm(across)
        return 2.0 * np.outer(across, across) - np.eye(3)
    skew = np.cross(np.eye(3), axis)
    return np.eye(3) + skew + skew @ skew / (1.0 + cosine)
