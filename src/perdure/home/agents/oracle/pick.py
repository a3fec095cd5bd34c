"""Oracle pick: drive within reach, approach from above (in a fridge from the front), grasp, return to rest."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from perdure.home.agents.oracle.collision_query import CollisionQuery
from perdure.home.agents.oracle.gripper_goals import goals_aside, pick_gripper_goals
from perdure.home.agents.oracle.motions import (
    Motion,
    View,
    move_arm,
    rest_arm,
    settled,
    together,
    turn_and_go,
    unjam,
    unwound,
)
from perdure.home.agents.oracle.reach_plan import ReachPlan, plan_from_here, plan_reach
from perdure.home.sim.apartments import Pose
from perdure.home.sim.arrays import FloatArray
from perdure.home.sim.world import GRASP, GRASP_RADIUS
from perdure.home.sim.world.handles import Handles

ATTEMPTS = 3
SAFE = 0.002
"""Safety margin of the grasp radius in [m]: the robot still moves when its hand closes."""


def pick(view: View) -> Motion:
    """Pick the target."""
    target = int(view.state.target[0])
    for _ in range(ATTEMPTS):
        yield from unjam(view)
        plan = plan_pick(CollisionQuery(view.simulator), view.state.object[0].copy(), target, view.base)
        if plan is None:
            return
        yield from approach(view, plan, lambda: _can_grasp(view, target))
        if _can_grasp(view, target):
            yield view.action(grip=GRASP)
        yield from retreat(view, plan)
        if view.simulator.held >= 0:
            return


def _can_grasp(view: View, target: int) -> bool:
    """Return whether a grasp now would take the target."""
    simulator, gripper = view.simulator, view.state.gripper[0]
    middles = simulator.qpos[simulator.scene.middles]
    distance = np.linalg.norm(middles - gripper, axis=1)
    handles = Handles.of(simulator.scene.apartment).at(simulator.qpos[simulator.scene.link_qpos])
    handle_near = np.linalg.norm(handles - gripper, axis=1).min() <= GRASP_RADIUS + SAFE
    return bool(distance.argmin() == target and distance[target] < GRASP_RADIUS - SAFE and not handle_near)


def plan_pick(
    query: CollisionQuery, point: FloatArray, target: int, base: Pose, stands: list[Pose] | None = None
) -> ReachPlan | None:
    """Return where to stand and how to reach an object; `stands` None: what one turn and one drive reach."""
    simulator = query.simulator
    addresses = simulator.scene.object_qpos
    others = [simulator.qpos[a : a + 3] for k, a in enumerate(addresses) if k != target]
    handles = query.handles()
    neighbors = np.concatenate([np.array(others).reshape(-1, 3), handles])
    neighbors = neighbors[np.linalg.norm(neighbors - point, axis=1) < 0.5]
    inside = query.in_fridge(point)
    gripper_goals = pick_gripper_goals(point, np.array([base.x, base.y]), neighbors, inside)
    firm = -1 if inside else target  # in a fridge there is but one way in, and the target may give way a little
    if stands is not None:
        return plan_reach(query, stands, gripper_goals, firm)
    origin = np.array([base.x, base.y])
    return plan_from_here(query, base, gripper_goals, point, firm, lambda: goals_aside(point, origin, neighbors))


def approach(view: View, plan: ReachPlan, until: Callable[[], bool] = lambda: False) -> Motion:
    """Drive to the entry of a plan, move the arm to its poses, drive on to the plan's base pose.

    Ends early as soon as `until` holds.
    """
    drive = turn_and_go(view, plan.entry.yaw, _along(view, plan.entry))
    arm = move_arm(view, list(plan.poses[:1]), 0, until)
    if _clear_on_the_way(view, plan):
        yield from together(drive, arm)
    else:
        yield from drive
        yield from arm
    if plan.entry != plan.base:  # in over a shelf, then down
        yield from settled(view)
        yield from turn_and_go(view, plan.base.yaw, _along(view, plan.base), until)
    yield from move_arm(view, list(plan.poses[1:]), until=until)


def _clear_on_the_way(view: View, plan: ReachPlan) -> bool:
    """Return whether the arm may already move while the base drives."""
    query, now, end = CollisionQuery(view.simulator), view.base, plan.entry
    for share in (0.0, 0.5):
        stand = Pose(now.x + share * (end.x - now.x), now.y + share * (end.y - now.y), end.yaw)
        if query.path_depth(stand, view.arm, unwound(plan.poses[0], view.arm), points=4) > 0.0:
            return False
    return True


def retreat(view: View, plan: ReachPlan) -> Motion:
    """Retreat: lift, drive out, and move the arm to rest."""
    yield from move_arm(view, [plan.poses[0]], settle=0)
    if plan.entry != plan.base:
        yield from turn_and_go(view, plan.base.yaw, _along(view, plan.entry))
    yield from rest_arm(view)


def _along(view: View, stand: Pose) -> float:
    """Return the distance to a standing place along the heading."""
    away = np.array([stand.x - view.base.x, stand.y - view.base.y])
    return float(away @ (np.cos(stand.yaw), np.sin(stand.yaw)))
