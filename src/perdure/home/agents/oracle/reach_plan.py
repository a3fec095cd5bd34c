"""Reach plans: a search over standing places and gripper directions for a collision-free arm motion."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from perdure.home.agents.oracle.collision_query import CollisionQuery
from perdure.home.sim.apartments import FreeSpace, Pose
from perdure.home.sim.arrays import FloatArray, IntArray
from perdure.home.sim.robot import reach_many
from perdure.home.sim.robot.data import REST_ARM
from perdure.home.sim.world import ARM_STEP
from perdure.home.sim.world.state import wrap

DEPTH_COST = 1e4
"""Cost of a meter of penetration in control steps."""
FARTHEST = 1.2
"""Largest horizontal distance in [m] for which inverse kinematics is tried."""
OTHER_STARTS = ((-0.268, -0.3, 0.367, 1.9, 0.06, 1.2, 0.067), (0.3, -0.9, -0.6, 1.5, 0.6, 1.5, -0.5))
"""Start poses of inverse kinematics besides the rest pose."""
PER_STAND = 25
"""Plans tested at one standing place: an obstacle for one of them blocks most of the others."""
FINE = 25
"""Test points on a path that is about to be chosen."""
AHEAD = (0.0, 0.15, 0.3, -0.15, 0.45, -0.3, 0.6)
TURNS = (0.0, 0.3, -0.3)
"""First standing places: drives in [m], turns in [rad]."""
FARTHER_AHEAD = (0.75, 0.9, 1.05, 1.2)
"""Drives in [m] tried when none of the shorter ones is free: a start region may begin 1.8 m from its object."""
FINE_AHEAD = (0.0, 0.1, 0.2, 0.3, 0.4, -0.1, 0.5)
FINE_TURNS = (0.0, 0.1, -0.1, 0.2, -0.2, 0.3, -0.3)
FINE_CHECKS = 600
"""Finer drives and turns for a fridge, and the number of plans tested there, when none of the others is free."""
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
    upright: bool
    """Whether its z axis must point up (then the approach must be level)."""
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

    None when no standing place lets the arm reach. The gripper goals must all be upright or none; `firm` is an object
    that must not be pushed aside. The quickest `checks` plans are tested for collisions.
    """
    candidates = _reachable(query, list(stands), gripper_goals)
    best: ReachPlan | None = None
    blocked: dict[Pose, float] = {}
    rest = np.array(REST_ARM)
    tried: Counter[Pose] = Counter()
    for stand, via, end, steps, back in candidates:
        tried[stand] += 1
        if tried[stand] > PER_STAND:
            continue
        if tried.total() > checks:
            break
        entry = _behind(stand, back)
        if entry not in blocked:
            blocked[entry] = query.depth(entry, rest, firm=firm)
        worst = max(blocked[entry], query.depth(stand, end, firm=firm))
        if best is not None and steps + DEPTH_COST * worst >= best.cost:
            continue
        if back > 0.0:
            drive = [query.depth(_behind(stand, share * back), end, firm=firm) for share in (0.25, 0.5, 0.75, 1.0)]
            worst = max(worst, *drive)
        worst = max(worst, query.path_depth(entry, via, end, firm=firm, points=4))
        if best is None or steps + DEPTH_COST * worst < best.cost:
            worst = max(worst, query.path_depth(entry, rest, via, firm=firm, points=7))
        if worst == 0.0:  # between seven points there is room for a shelf
            worst = query.path_depth(entry, rest, via, firm=firm, points=FINE)
        plan = ReachPlan(entry, stand, (via, end), worst, steps)
        if best is None or plan.cost < best.cost:
            best = plan
        if plan.free:
            break
    return best


def plan_from_here(
    query: CollisionQuery,
    base: Pose,
    gripper_goals: Sequence[GripperGoal],
    point: FloatArray,
    firm: int = -1,
    others: Callable[[], Sequence[GripperGoal]] = tuple,
) -> ReachPlan | None:
    """Return a plan from what one turn and one drive reach, facing a point (3,); when nothing is free, from farther.

    In a fridge also from finer drives and turns, then with the gripper goals `others()` in addition. See `plan_reach`.
    """
    found = [plan_reach(query, ahead(base, point, AHEAD, TURNS), gripper_goals, firm)]
    if found[0] is None or not found[0].free:
        found.append(plan_reach(query, ahead(base, point, FARTHER_AHEAD, TURNS), gripper_goals, firm))
    if query.in_fridge(point) and not _any_free(found):
        finer, gripper_goals = list(ahead(base, point, FINE_AHEAD, FINE_TURNS)), [*gripper_goals, *others()]
        found.append(plan_reach(query, finer, gripper_goals, firm, FINE_CHECKS))
        if not _any_free(found):
            farther = [replace(gripper_goal, back=FAR_BACK) for gripper_goal in gripper_goals]
            found.append(plan_reach(query, finer, farther, firm, FINE_CHECKS))
    return min((plan for plan in found if plan is not None), key=lambda plan: plan.cost, default=None)


def _any_free(plans: Iterable[ReachPlan | None]) -> bool:
    return any(plan is not None and plan.free for plan in plans)


def _behind(stand: Pose, back: float) -> Pose:
    return Pose(stand.x - back * float(np.cos(stand.yaw)), stand.y - back * float(np.sin(stand.yaw)), stand.yaw)


def _reachable(
    query: CollisionQuery, stands: Sequence[Pose], gripper_goals: Sequence[GripperGoal]
) -> list[tuple[Pose, FloatArray, FloatArray, float, float]]:
    """Return all standing places and gripper_goals that inverse kinematics can join, the quickest first."""
    pairs = [(s, w) for s in stands for w in gripper_goals]
    pairs = [(s, w) for s, w in pairs if np.hypot(s.x - w.point[0], s.y - w.point[1]) < FARTHEST]
    if not pairs:
        return []
    points = np.array([s.to_local(w.point) for s, w in pairs])
    vias = np.array([s.to_local(w.point + w.before) for s, w in pairs])
    approach = np.array([Pose(0.0, 0.0, -s.yaw).to_room(w.approach) for s, w in pairs])
    upright, rest = pairs[0][1].upright, np.array(REST_ARM)
    # Of the arm's ways to hold its hand level the one nearest to rest need not be the one that is found from rest.
    starts = (REST_ARM, *OTHER_STARTS) if upright else (REST_ARM,)
    pairs, points, vias, approach = (
        pairs * len(starts),
        *(np.tile(x, (len(starts), 1)) for x in (points, vias, approach)),
    )
    first = np.repeat(np.array(starts), len(points) // len(starts), axis=0)
    end, way, turn = reach_many(points, approach, upright, first)
    good = (way < CLOSE) & (turn < (0.05 if upright else 0.3))
    rows = np.nonzero(good)[0]
    if not len(rows):
        return []
    via, via_way, _ = reach_many(vias[rows], approach[rows], upright, end[rows], iterations=12)
    now, found = query.simulator.robot, []
    for row, middle, miss in zip(rows, via, via_way, strict=True):
        stand = pairs[row][0]
        turning = abs(float(wrap(np.array(stand.yaw - now[2]))))
        drive = 25.0 * float(np.hypot(stand.x - now[0], stand.y - now[1])) + 15.0 * turning
        arm = (np.abs(middle - rest).max() + np.abs(end[row] - middle).max()) / ARM_STEP
        if miss < 3.0 * CLOSE:
            back = pairs[row][1].back
            found.append((stand, middle, end[row], float(arm + drive + 30.0 * back), back))
    return sorted(found, key=lambda each: each[3])


def ahead(base: Pose, toward: FloatArray, steps: Sequence[float], turns: Sequence[float]) -> Iterator[Pose]:
    """Standing places that one turn and one straight drive reach: facing a point give or take a turn, then ahead."""
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
