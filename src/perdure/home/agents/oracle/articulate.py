"""Oracle for drawers and the fridge's door: grasp the handle, move it along its path, release, return to rest.

The arm keeps the gripper on the handle's way (damped least squares); the base drives to keep that way within reach.
"""

from __future__ import annotations

import numpy as np

from perdure.home.agents.oracle.collision_query import CollisionQuery
from perdure.home.agents.oracle.gripper_goals import handle_grabs
from perdure.home.agents.oracle.motions import Motion, View, reach_for, rest_arm, together, turn_and_go, unjam
from perdure.home.agents.oracle.pick import ATTEMPTS, SAFE, approach
from perdure.home.agents.oracle.reach_plan import AHEAD, FARTHER_AHEAD, TURNS, ReachPlan, ahead, plan_reach
from perdure.home.sim.apartments import Pose
from perdure.home.sim.arrays import FloatArray
from perdure.home.sim.world import CONTROL_HZ, GRASP, GRASP_RADIUS, RELEASE
from perdure.home.sim.world.handles import Handles

SPEED = 0.40
"""Of the handle in [m/s]."""
NEAREST, FARTHEST = 0.62, 0.85
"""Distances along the floor between which the base keeps the gripper in [m]."""
BACK = 0.15
"""Distance the robot backs off from a released handle, in [m]."""


def articulate(view: View, goal: float, enough: float) -> Motion:
    """Move the skill goal's drawer or door to within `enough` of `goal`. In [m] or [rad]."""
    link = int(view.state.link[0])
    for _ in range(ATTEMPTS):
        yield from unjam(view)
        plan = plan_handle(CollisionQuery(view.simulator), link, view.base)
        if plan is None:
            return
        yield from approach(view, plan, lambda: _near(view))
        yield view.action(grip=GRASP)
        if view.simulator.held_link == link:
            break
        if not view.state.empty_hand[0]:
            yield view.action(grip=RELEASE)
        yield from rest_arm(view)
    else:
        return
    yield from _carry(view, link, goal, enough)
    yield view.action(grip=RELEASE)
    yield from together(turn_and_go(view, view.base.yaw, -BACK), rest_arm(view))


def _near(view: View) -> bool:
    """Return whether the handle can be grasped."""
    return float(np.linalg.norm(view.state.handle[0] - view.state.gripper[0])) < GRASP_RADIUS - SAFE


def plan_handle(query: CollisionQuery, link: int, base: Pose, stands: list[Pose] | None = None) -> ReachPlan | None:
    """Return where to stand and how to reach a handle."""
    point, origin = query.handles()[link], np.array([base.x, base.y])
    gripper_goals = handle_grabs(point, origin, _sides(query, link, point, origin))
    if stands is not None:
        return plan_reach(query, stands, gripper_goals)
    plan = plan_reach(query, ahead(base, point, AHEAD, TURNS), gripper_goals)
    if plan is not None and plan.free:
        return plan
    farther = plan_reach(query, ahead(base, point, FARTHER_AHEAD, TURNS), gripper_goals)
    return min((each for each in (plan, farther) if each is not None), key=lambda each: each.cost, default=None)


def _sides(query: CollisionQuery, link: int, point: FloatArray, origin: FloatArray) -> list[FloatArray]:
    """Return directions from a handle in which the hand may wait: in front of a drawer; at a door's face or edge."""
    scene = query.simulator.scene
    handles = Handles.of(scene.apartment)
    if handles.sign[link] == 0.0:
        return [handles.slide[link]]
    q = query.position(link)
    out = handles.one(link, q + 0.01) - point
    radial = point - handles.origin[link]
    toward = np.array([*(origin - point[:2]), 0.0])
    face, edge, robot = (each / np.linalg.norm(each) for each in (out, radial * (1.0, 1.0, 0.0), toward))
    corner = (face + edge) / np.sqrt(2.0)
    return [robot, corner, edge, face]


def _carry(view: View, link: int, goal: float, enough: float) -> Motion:
    """Move the held handle: a target point moves along the handle's path, gripper and base follow it."""
    handles = Handles.of(view.simulator.scene.apartment)
    lever = float(np.hypot(*handles.lever[link])) or 1.0
    wanted = float(view.state.link_position[0])
    tool = view.state.turned_to_gripper(view.state.handle - view.state.gripper)[0]
    direction = float(np.sign(goal - wanted))
    for _ in range(150):
        now = float(view.state.link_position[0])
        if abs(goal - now) <= enough:
            break
        # The wanted place waits for the handle when it falls behind by more than a hand's breadth.
        if abs(wanted - now) * lever < 0.08:
            wanted += direction * min(SPEED / CONTROL_HZ / lever, abs(goal - wanted))
        ahead_of_it = handles.one(link, wanted + 0.02 * direction) - handles.one(link, wanted)
        along = view.base.to_local(ahead_of_it + np.array([view.base.x, view.base.y, 0.0]))
        local = view.base.to_local(handles.one(link, wanted))
        far, bearing = float(np.hypot(local[0], local[1])), float(np.arctan2(local[1], local[0]))
        forward = SPEED * along[0] / max(float(np.linalg.norm(along)), 1e-9)
        forward += 3.0 * (far - FARTHEST) if far > FARTHEST else 3.0 * (far - NEAREST) if far < NEAREST else 0.0
        turn = float(np.clip(bearing, -0.3, 0.3)) if abs(bearing) > 0.6 else 0.0
        arm = reach_for(view, handles.one(link, wanted), 0.7, tool)
        yield view.action(float(np.clip(forward, -0.7, 0.7)), turn, arm)
