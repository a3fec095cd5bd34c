"""Oracle place: hold the object level above its goal, wait until it is still, release, return to rest."""

from __future__ import annotations

import numpy as np

from perdure.home.agents.oracle.collision_query import CollisionQuery
from perdure.home.agents.oracle.gripper_goals import place_gripper_goals
from perdure.home.agents.oracle.motions import Motion, View, rest_arm, unjam
from perdure.home.agents.oracle.pick import approach, retreat
from perdure.home.agents.oracle.reach_plan import ReachPlan, plan_from_here, plan_reach
from perdure.home.sim.apartments import Pose
from perdure.home.sim.arrays import FloatArray
from perdure.home.sim.objects import YcbObjects
from perdure.home.sim.world import RELEASE

HEIGHT = 0.015
"""Height above the goal at which the object is released in [m]."""
PALM = 0.058
"""Smallest height of a level hand above a surface in [m]: its wrist extends 5.2 cm down. Flat objects drop the rest."""
STILL = 0.03
"""Speed of the gripper in [m/s] below which it counts as still."""


def place(view: View) -> Motion:
    """Place the target."""
    target = int(view.state.target[0])
    if view.simulator.held != target:
        yield from rest_arm(view)
        return
    goal = view.state.goal[0].copy()
    yield from unjam(view)
    plan = plan_place(CollisionQuery(view.simulator), goal, view.base)
    if plan is None:
        return
    yield from approach(view, plan)
    for _ in range(20):
        if np.linalg.norm(view.state.gripper_velocity[0]) < STILL:
            break
        yield view.action()
    yield view.action(grip=RELEASE)
    yield from retreat(view, plan)


def plan_place(
    query: CollisionQuery, goal: FloatArray, base: Pose, stands: list[Pose] | None = None
) -> ReachPlan | None:
    """Return where to stand and how to bring the held object to its goal."""
    held = query.simulator.held
    half = YcbObjects().box(query.simulator.scene.placements[held].kind)[1][2] if held >= 0 else PALM
    gripper_goals = place_gripper_goals(
        goal, np.array([base.x, base.y]), max(HEIGHT, PALM - half), query.in_fridge(goal)
    )
    return (
        plan_from_here(query, base, gripper_goals, goal) if stands is None else plan_reach(query, stands, gripper_goals)
    )
