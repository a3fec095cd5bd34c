"""Oracle navigation: drive the shortest way to a cell from which the next skill works, then face the aim."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np

from perdure.home.agents.oracle.articulate import plan_handle
from perdure.home.agents.oracle.collision_query import CollisionQuery
from perdure.home.agents.oracle.motions import Motion, View, follow, turn_to
from perdure.home.agents.oracle.pick import plan_pick
from perdure.home.agents.oracle.place import plan_place
from perdure.home.agents.oracle.reach_plan import ReachPlan, ahead, around
from perdure.home.sim.apartments import Apartment, Pose, free_space, plane
from perdure.home.sim.apartments.footprint import apartment_footprints
from perdure.home.sim.arrays import FloatArray
from perdure.home.sim.world import SkillGoal
from perdure.home.skills.starts.containers import open_links

BEST_DISTANCE = {
    "pick": 0.72,
    "place": 0.72,
    "open_drawer": 0.85,
    "close_drawer": 0.5,
    "open_fridge": 0.95,
    "close_fridge": 0.9,
}
"""Best distance from the aim for each skill, along the floor in [m]."""
ARM_LOW, ARM_REACH = 0.7, 0.75
"""Height below which furniture cannot touch the resting arm, and reach of the arm with a held object, in [m]."""
CLOSENESS = 0.06
"""Meters of distance per unit of `arm_cost` in the choice of a standing place."""
ELSEWHERE = 0.3
"""Smallest distance of the next standing place from one that could not be reached, in [m]."""
PLACES = 10
"""Largest number of standing places tried."""
STEPS_AHEAD = (0.0, 0.15, 0.3, 0.45)
"""Distances that the next skill may drive on from a standing place, in [m]."""


def navigate(view: View) -> Motion:
    """Drive to a place from which the next skill works."""
    skill_goal = view.world.skill_goal(view.number)
    route, toward = skill_goal.route, skill_goal.toward
    assert route is not None
    goals = np.nonzero(route.values == 0.0)[0]
    aim = np.array(skill_goal.aim)
    cost = arm_cost(view.simulator.scene.apartment, tuple(sorted(open_links(view.simulator).items())))
    stands = list(around(route.space, goals, aim, BEST_DISTANCE[toward], PLACES, CLOSENESS * (cost - 1.0)))
    while stands:
        plan = _plan(view, skill_goal, stands)
        stand = stands[0] if plan is None else plan.base
        cell, _ = route.space.nearest(np.array([[stand.x, stand.y]]))
        way = route.space.distances(cell, cost).path(np.array([view.base.x, view.base.y]), tight=False)
        yield from follow(view, np.concatenate([way, [[stand.x, stand.y]]]))
        if _apart(view.base, stand) < ELSEWHERE:
            break
        stands = [other for other in stands if _apart(other, stand) > ELSEWHERE]  # it cannot be reached
    yield from turn_to(view, float(np.arctan2(aim[1] - view.base.y, aim[0] - view.base.x)))


def _apart(one: Pose, other: Pose) -> float:
    return float(np.hypot(one.x - other.x, one.y - other.y))


@lru_cache(maxsize=64)
def arm_cost(apartment: Apartment, opened: tuple[tuple[str, float], ...]) -> FloatArray:
    """Return the cost of a meter at each free cell: higher where the resting arm may touch tall furniture."""
    space = free_space(apartment, dict(opened))
    tall = apartment_footprints(apartment, dict(opened), low=ARM_LOW)
    near = plane.clearance(space.centers, tall)
    return 1.0 + 5.0 * np.clip((ARM_REACH - near) / (ARM_REACH - 0.3), 0.0, 1.0)


def _plan(view: View, skill_goal: SkillGoal, stands: list[Pose]) -> ReachPlan | None:
    """Return the skill's own plan from the first standing place that works, each with a step ahead or back."""
    best: ReachPlan | None = None
    query = CollisionQuery(view.simulator)
    aim = np.array(skill_goal.aim)
    for stand in stands:
        places = list(ahead(stand, aim, STEPS_AHEAD, (0.0,)))
        if skill_goal.toward == "pick":
            plan = plan_pick(query, view.state.object[0].copy(), skill_goal.target, stand, places)
        elif skill_goal.toward == "place":
            plan = plan_place(query, aim, stand, places)
        else:
            plan = plan_handle(query, skill_goal.link, stand, places)
        if plan is not None:
            plan = replace(plan, base=stand)
        if plan is not None and (best is None or plan.depth < best.depth):
            best = plan
        if best is not None and best.free:
            break
    return best
