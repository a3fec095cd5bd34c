"""Plans that bring the gripper to a goal: standing places and arm poses, tested with collision queries."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from perdure.home.sim.arrays import FloatArray, IntArray
from perdure.home.sim.kinematics import about_z, gripper_in_room, reach_many
from perdure.home.sim.occupancy import FreeSpace
from perdure.home.sim.pieces import Pose
from perdure.home.sim.robot import ROBOT
from perdure.home.sim.sensors import wrap
from perdure.home.sim.simulator import ARM_STEP, Simulator

PUSHABLE_WEIGHT = 0.25
"""Weight of penetration into a loose object, relative to furniture."""
TOLERATED_DEPTH = 0.002
"""Penetration in [m] that does not count as a contact."""


class CollisionQuery:
    """A second `MjData` of a lane's model, with the rest of the world frozen at the time of the query."""

    def __init__(self, simulator: Simulator) -> None:
        """Copy the state of a lane."""
        import mujoco

        self._mujoco = mujoco
        self.simulator = simulator
        simulator.search_all()  # where the query goes there may be what the robot cannot reach from here
        self._data: Any = mujoco.MjData(simulator.model)
        self._data.qpos[:] = simulator.qpos
        self._start: FloatArray = np.array(simulator.qpos)
        self._held = simulator.held

    def is_behind_door(self, point: FloatArray) -> bool:
        """Return whether a point of the room is in a container with a door."""
        return self.simulator.scene.apartment.is_behind_door(np.asarray(point))

    def depth(self, base: Pose, arm: ArrayLike, firm: int = -1) -> float:
        """Return the penetration of the robot and the held object at a pose in [m], 0 for free; arm of shape (joints,).

        `firm` is the number of an object that must not be pushed aside.
        """
        scene = self.simulator.scene
        data = self._data
        data.qpos[:] = self._start
        robot = data.qpos[scene.robot_qpos]
        robot[:3] = (base.x, base.y, base.yaw)
        robot[ROBOT.torso_column] = ROBOT.torso_height
        robot[ROBOT.arm_columns] = arm
        if self._held >= 0:
            position, axes = gripper_in_room(base, np.asarray(arm, dtype=np.float64))
            hand = self.simulator.hand
            address = scene.object_qpos[self._held]
            data.qpos[address : address + 3] = position + axes @ hand.offset
            self._mujoco.mju_mat2Quat(data.qpos[address + 3 : address + 7], (axes @ hand.turn).ravel())
        self._mujoco.mj_kinematics(self.simulator.model, data)
        self._mujoco.mj_collision(self.simulator.model, data)
        return self._deepest(firm)

    def _deepest(self, firm: int) -> float:
        scene = self.simulator.scene
        geoms = self._data.contact.geom
        distance = self._data.contact.dist
        if not len(distance):
            return 0.0

        # Contacts between the robot with what it holds, and anything else.
        robot = scene.robot_geoms[geoms]
        ours = robot.any(axis=1)
        if self._held >= 0:
            carried = np.isin(geoms, scene.object_geoms[self._held])
            ours = (robot | carried).any(axis=1) & ~(robot | carried).all(axis=1)
        # What can be pushed aside is less of an obstacle than what cannot.
        loose = np.isin(scene.model.geom_bodyid[geoms], scene.object_bodies).any(axis=1)
        if firm >= 0:
            loose &= ~np.isin(geoms, scene.object_geoms[firm]).any(axis=1)
        deep = np.maximum(-distance - TOLERATED_DEPTH, 0.0) * np.where(loose, PUSHABLE_WEIGHT, 1.0)
        if not ours.any():
            return 0.0
        return float(deep[ours].max())

    def path_depth(self, base: Pose, start: ArrayLike, end: ArrayLike, firm: int = -1, points: int = 8) -> float:
        """Return the deepest touch on the straight way between two arm poses, both ends included, in [m]."""
        first = np.asarray(start, dtype=np.float64)
        last = np.asarray(end, dtype=np.float64)
        return max(self.depth(base, first + share * (last - first), firm) for share in np.linspace(0.0, 1.0, points))


DEPTH_COST = 1e4
"""Cost of a meter of penetration in control steps."""
FARTHEST = 1.2
"""Largest horizontal distance in [m] for which inverse kinematics is tried."""
PER_STAND = 25
"""Plans tested at one standing place: an obstacle for one of them blocks most of the others."""
FINE_POINTS = 25
"""Test points on a path that is about to be chosen."""
STANDS_AHEAD = (0.0, 0.15, 0.3, -0.15, 0.45, -0.3, 0.6)
TURNS = (0.0, 0.3, -0.3)
"""First standing places: drives in [m], turns in [rad]."""
FARTHER_AHEAD = (0.75, 0.9, 1.05, 1.2)
"""Drives in [m] tried when none of the shorter ones is free: a start region may begin 1.8 m from its object."""
FINE_AHEAD = (0.0, 0.1, 0.2, 0.3, 0.4, -0.1, 0.5)
FINE_TURNS = (0.0, 0.1, -0.1, 0.2, -0.2, 0.3, -0.3)
FINE_CHECKS = 600
"""Finer drives and turns to what is behind a door, and the number of plans tested there, when no other one is free."""
FAR_BACK = 0.6
"""Distance in [m] at which the robot raises its arm when nearer the arm would touch the edge of a shelf."""
CLOSE = 0.01
"""Largest position error of a pose in [m]."""


@dataclass(frozen=True)
class GripperGoal:
    """An acceptable gripper pose."""

    point: FloatArray
    """Gripper point in the room. Shape (3,)."""
    approach: FloatArray
    """Direction of the gripper's x axis in the room. Shape (3,)."""
    axes: FloatArray | None
    """Its axes in the room, one per column; None when the roll about x is free. Shape (3, 3)."""
    before: FloatArray
    """Displacement from `point` to the pre-grasp point, in the room. Shape (3,)."""
    back: float = 0.0
    """Distance behind the standing place at which the arm is raised in [m], to drive the gripper in and out."""


@dataclass(frozen=True)
class ReachPlan:
    """Standing places, and arm poses from rest to the gripper goal."""

    entry: Pose
    """Base pose at which the arm moves from rest to its poses."""
    base: Pose
    """Final base pose, straight ahead of `entry`."""
    poses: tuple[FloatArray, ...]
    depth: float
    """Largest penetration on the way in [m]; 0 is collision-free."""
    steps: float
    """Approximate number of control steps."""

    @property
    def free(self) -> bool:
        """Whether the plan is collision-free."""
        return self.depth == 0.0

    @property
    def cost(self) -> float:
        """Cost in steps; a centimeter of penetration costs a hundred."""
        return self.steps + DEPTH_COST * self.depth


def plan_reach(
    query: CollisionQuery,
    stands: Iterable[Pose],
    gripper_goals: Sequence[GripperGoal],
    firm: int = -1,
    checks: int = 200,
) -> ReachPlan | None:
    """Return the fastest collision-free plan to a gripper goal, else the plan with the least cost.

    None when no standing place lets the arm reach. The gripper goals must all have axes or none; `firm` is an object
    that must not be pushed aside. The quickest `checks` plans are tested for collisions.
    """
    most = np.inf
    best: ReachPlan | None = None
    blocked: dict[Pose, float] = {}
    tried: Counter[Pose] = Counter()
    for candidate in _reachable(query, list(stands), gripper_goals):
        # Spread the tests over the standing places.
        tried[candidate.stand] += 1
        if tried[candidate.stand] > PER_STAND:
            continue
        if tried.total() > checks:
            break

        # The two ends of the way are quick to test: a candidate that loses there is not looked at further.
        entry = _behind(candidate.stand, candidate.back)
        if entry not in blocked:
            blocked[entry] = query.depth(entry, ROBOT.rest_arm, firm=firm)
        depth = max(blocked[entry], query.depth(candidate.stand, candidate.end, firm=firm))
        if candidate.steps + DEPTH_COST * depth >= most:
            continue

        # The way itself.
        depth = _depth_on_the_way(query, candidate, entry, firm, depth, most)
        plan = ReachPlan(entry, candidate.stand, (candidate.via, candidate.end), depth, candidate.steps)
        if plan.cost < most:
            best = plan
            most = plan.cost
        if plan.free:
            break
    return best


def _depth_on_the_way(
    query: CollisionQuery, candidate: _Candidate, entry: Pose, firm: int, depth: float, most: float
) -> float:
    """Return the deepest touch of a candidate in [m], beginning with the `depth` at the ends of its way.

    The longest part is only tested where the others leave the candidate cheaper than `most`.
    """
    via = candidate.via
    end = candidate.end
    if candidate.back > 0.0:
        for share in (0.25, 0.5, 0.75, 1.0):
            place = _behind(candidate.stand, share * candidate.back)
            depth = max(depth, query.depth(place, end, firm=firm))
    depth = max(depth, query.path_depth(entry, via, end, firm=firm, points=4))
    if candidate.steps + DEPTH_COST * depth < most:
        depth = max(depth, query.path_depth(entry, ROBOT.rest_arm, via, firm=firm, points=7))
    if depth == 0.0:  # between seven points there is room for a shelf
        depth = query.path_depth(entry, ROBOT.rest_arm, via, firm=firm, points=FINE_POINTS)
    return depth


def plan_from(
    query: CollisionQuery,
    base: Pose,
    gripper_goals: Sequence[GripperGoal],
    point: FloatArray,
    stands: Sequence[Pose] | None = None,
    firm: int = -1,
    others: Callable[[], Sequence[GripperGoal]] = tuple,
) -> ReachPlan | None:
    """Return a plan from some standing places, or from what one turn and one drive reach, facing a point (3,).

    When nothing is free, from farther. Behind a door also from finer drives and turns, then with the gripper goals
    `others()` in addition. See `plan_reach`.
    """
    if stands is not None:
        return plan_reach(query, stands, gripper_goals, firm)
    found: list[ReachPlan | None] = []
    for steps in (STANDS_AHEAD, FARTHER_AHEAD):
        if not _any_free(found):
            found.append(plan_reach(query, ahead(base, point, steps, TURNS), gripper_goals, firm))
    if query.is_behind_door(point) and not _any_free(found):
        finer = list(ahead(base, point, FINE_AHEAD, FINE_TURNS))
        gripper_goals = [*gripper_goals, *others()]
        found.append(plan_reach(query, finer, gripper_goals, firm, FINE_CHECKS))
        if not _any_free(found):
            farther = [replace(gripper_goal, back=FAR_BACK) for gripper_goal in gripper_goals]
            found.append(plan_reach(query, finer, farther, firm, FINE_CHECKS))
    return min((plan for plan in found if plan is not None), key=lambda plan: plan.cost, default=None)


def _any_free(plans: Iterable[ReachPlan | None]) -> bool:
    return any(plan is not None and plan.free for plan in plans)


def _behind(stand: Pose, back: float) -> Pose:
    return Pose(stand.x - back * float(np.cos(stand.yaw)), stand.y - back * float(np.sin(stand.yaw)), stand.yaw)


@dataclass(frozen=True, eq=False)
class _Candidate:
    """A standing place, and arm poses that bring the gripper to a goal from there."""

    stand: Pose
    via: FloatArray
    """The arm before the last straight motion. Shape (joints,)."""
    end: FloatArray
    """The arm at the goal. Shape (joints,)."""
    steps: float
    """Approximate number of control steps."""
    back: float
    """See `GripperGoal`."""


def _reachable(query: CollisionQuery, stands: Sequence[Pose], gripper_goals: Sequence[GripperGoal]) -> list[_Candidate]:
    """Return all standing places and gripper goals that inverse kinematics can join, the quickest first."""
    pairs = [(s, w) for s in stands for w in gripper_goals if np.hypot(s.x - w.point[0], s.y - w.point[1]) < FARTHEST]
    if not pairs:
        return []
    points = np.array([s.to_local(w.point) for s, w in pairs])
    vias = np.array([s.to_local(w.point + w.before) for s, w in pairs])
    approach = np.array([Pose(0.0, 0.0, -s.yaw).to_room(w.approach) for s, w in pairs])

    # Of the arm's ways to hold its hand in given axes the one nearest to rest need not be the one found from rest.
    axes: FloatArray | None = None
    starts = ROBOT.rest_arm[None]
    most_turn = 0.3
    if pairs[0][1].axes is not None:
        axes = np.array([about_z(-s.yaw) @ w.axes for s, w in pairs if w.axes is not None])
        starts = np.concatenate([starts, ROBOT.other_arms])
        axes = np.tile(axes, (len(starts), 1, 1))
        most_turn = 0.05
    first = np.repeat(starts, len(pairs), axis=0)
    pairs = pairs * len(starts)
    points = np.tile(points, (len(starts), 1))
    vias = np.tile(vias, (len(starts), 1))
    approach = np.tile(approach, (len(starts), 1))

    # The last pose first, then from it the one before.
    end, way, turn = reach_many(points, approach, axes, first)
    rows = np.nonzero((way < CLOSE) & (turn < most_turn))[0]
    if not len(rows):
        return []
    if axes is not None:
        axes = axes[rows]
    via, via_way, _ = reach_many(vias[rows], approach[rows], axes, end[rows], iterations=12)

    now = query.simulator.robot
    found = []
    for row, middle, miss in zip(rows, via, via_way, strict=True):
        if miss >= 3.0 * CLOSE:
            continue
        stand, gripper_goal = pairs[row]
        turning = abs(float(wrap(np.array(stand.yaw - now[2]))))
        drive = 25.0 * float(np.hypot(stand.x - now[0], stand.y - now[1])) + 15.0 * turning
        arm = (np.abs(middle - ROBOT.rest_arm).max() + np.abs(end[row] - middle).max()) / ARM_STEP
        steps = float(arm + drive + 30.0 * gripper_goal.back)
        found.append(_Candidate(stand, middle, end[row], steps, gripper_goal.back))
    return sorted(found, key=lambda each: each.steps)


def ahead(base: Pose, toward: FloatArray, steps: Sequence[float], turns: Sequence[float]) -> Iterator[Pose]:
    """Yield standing places that one turn and one straight drive reach: facing a point give or take a turn, ahead."""
    facing = float(np.arctan2(toward[1] - base.y, toward[0] - base.x))
    for turn in turns:
        for step in steps:
            yaw = facing + turn
            yield Pose(base.x + step * float(np.cos(yaw)), base.y + step * float(np.sin(yaw)), yaw)


def around(
    space: FreeSpace, cells: IntArray, point: FloatArray, best: float, count: int, cost: FloatArray
) -> Iterator[Pose]:
    """Yield up to `count` standing places on cells, facing a point: those nearest to the distance `best` in [m] first.

    `cells` are indices into the centers of the free space; `cost` is what standing on each of its cells costs, in
    meters of distance, shape (n,).
    """
    centers = space.centers[cells]
    away = np.hypot(*(centers - point[:2]).T)
    taken: list[FloatArray] = []
    for index in np.argsort(np.abs(away - best) + cost[cells], kind="stable"):
        center = centers[index]
        if any(np.hypot(*(center - other)) < 0.2 for other in taken):
            continue
        taken.append(center)
        yield Pose(float(center[0]), float(center[1]), float(np.arctan2(*(point[:2] - center)[::-1])))
        if len(taken) >= count:
            return
