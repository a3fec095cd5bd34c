"""Oracle pick: stand where the arm reaches, come from above (or from the front in a fridge), grasp, go back to rest."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from perdure.home.layouts import Pose
from perdure.home.oracle.ghost import Ghost
from perdure.home.oracle.motions import Motion, View, move_arm, rest_arm, together, turn_and_go
from perdure.home.oracle.placing import ReachPlan, ahead, plan_reach
from perdure.home.oracle.wishes import pick_wishes
from perdure.home.world import GRASP

FloatArray = NDArray[np.float64]

AHEAD = (0.0, 0.15, 0.3, -0.15, 0.45, -0.3, 0.6)
TURNS = (0.0, 0.3, -0.3)


def pick(view: View) -> Motion:
    """Picks the errand's object."""
    target = int(view.sensors.target[0])
    point = view.sensors.object[0].copy()
    plan = plan_pick(Ghost(view.lane), point, target, view.base)
    if plan is None:
        return
    yield from approach(view, plan)
    yield view.action(grip=GRASP)
    held = view.lane.held
    if held != target and held >= 0:
        return
    yield from move_arm(view, [plan.poses[0]], settle=0)
    yield from rest_arm(view)


def plan_pick(
    ghost: Ghost, point: FloatArray, target: int, base: Pose, stands: list[Pose] | None = None
) -> ReachPlan | None:
    """Where to stand and how to reach an object; `stands` None: what one turn and one drive reach."""
    lane = ghost.lane
    addresses = lane.scene.object_qpos
    others = [lane.qpos[a : a + 3] for k, a in enumerate(addresses) if k != target]
    handles = ghost.handles()
    rivals = np.concatenate([np.array(others).reshape(-1, 3), handles])
    rivals = rivals[np.linalg.norm(rivals - point, axis=1) < 0.5]
    wishes = pick_wishes(point, np.array([base.x, base.y]), rivals, ghost.in_fridge(point))
    places = list(ahead(base, point, AHEAD, TURNS)) if stands is None else stands
    return plan_reach(ghost, places, wishes, ignore=target)


def approach(view: View, plan: ReachPlan) -> Motion:
    """Drives to where a plan stands and brings the arm to its last pose."""
    away = np.array([plan.base.x - view.base.x, plan.base.y - view.base.y])
    along = float(away @ (np.cos(plan.base.yaw), np.sin(plan.base.yaw)))
    drive = turn_and_go(view, plan.base.yaw, along)
    # The arm may start while the base drives, if it ends up nearer: then nothing is behind it.
    yield from together(drive, move_arm(view, list(plan.poses[:1]), settle=0))
    yield from move_arm(view, list(plan.poses[1:]))
