"""The oracle: scripted motions for every skill, with full knowledge of the world.

Each motion is a generator of actions: it looks for a gripper pose that inverse kinematics and the collision query
allow, and moves there. A held drawer or door is pulled along the path of its handle: the arm keeps the gripper on it
(damped least squares), the base drives to keep it within reach.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import lru_cache
from itertools import product

import numpy as np

from perdure.home.agents.learned import Motion, SkillAgent
from perdure.home.agents.motions import (
    View,
    follow,
    move_arm,
    reach_for,
    rest_arm,
    settled,
    together,
    turn_and_go,
    turn_to,
    unjam,
    unwound,
)
from perdure.home.agents.reach_plans import CollisionQuery, GripperGoal, ReachPlan, ahead, around, plan_from
from perdure.home.sim import occupancy
from perdure.home.sim.arrays import FloatArray, IntArray
from perdure.home.sim.hand import GRASP_RADIUS
from perdure.home.sim.kinematics import about_z
from perdure.home.sim.objects import get_kind
from perdure.home.sim.occupancy import apartment_footprints, free_space
from perdure.home.sim.pieces import Apartment, Pose
from perdure.home.sim.robot import ROBOT
from perdure.home.sim.scene import CONTROL_HZ
from perdure.home.sim.sensors import PrivilegedState, SkillGoal
from perdure.home.sim.simulator import GRASP, RELEASE
from perdure.home.sim.vector_simulator import VectorSimulator
from perdure.home.skills import SKILLS, Skill, SkillProgress
from perdure.home.skills.articulated import Articulated
from perdure.home.skills.starts import open_links
from perdure.home.tasks.tasks import Verb

STANDOFFS = (0.11, 0.08, 0.05)
"""Distances from the gripper point to the middle of the object to be grasped in [m]: within the magic grasp's reach."""
NEIGHBOR_GAP = 0.02
"""Margin in [m] by which other objects and handles must be farther from the gripper point than the target."""
SLOPES = (np.radians(60.0), np.radians(90.0), np.radians(35.0), np.radians(0.0))
"""Downward angles of the gripper on open surfaces, in [rad]."""
LOW = np.radians(40.0)
"""Largest downward angle in [rad] at which it takes what it will place behind a door: it holds it alike there."""
INSIDE_SLOPES = (np.radians(15.0), np.radians(0.0), np.radians(35.0), np.radians(55.0))
"""The same behind a door, as in a fridge."""
LIFT = 0.08
HIGH_LIFT = 0.25
"""Heights of the pre-grasp point above the grasp point in [m]."""
ASIDE = 0.11
"""Distance beside or above an object from which it is grasped when another one is in front of it, in [m]."""
GRASP_BACK = 0.4
"""Distance behind the standing place at which the arm is raised in front of a door, in [m]."""
GRASP_TURNS = (0.0, 0.5, -0.5)
"""Turns of the approach about the vertical, in [rad]."""
INSIDE_TURNS = (0.0, 0.4, -0.4, 0.8, -0.8)
"""The same behind a door, where one object may stand in front of another."""


PLACE_TURNS = (0.0, 0.25, -0.25, 0.5, -0.5, 0.8, -0.8)
"""Turns of the approach with an object in the hand, in [rad]."""


def pick_gripper_goals(point: FloatArray, origin: FloatArray, neighbors: FloatArray, inside: bool) -> list[GripperGoal]:
    """Return poses in which the magic grasp takes the object at a point (3,) and nothing else.

    The robot comes from `origin` on the floor, shape (2,). `neighbors` are the middles of other objects, and handles,
    shape (k, 3). `inside`: whether it is behind a door, where the gripper comes from the front, not from above.
    """
    slopes = SLOPES
    turns: tuple[float, ...] = GRASP_TURNS
    lift = LIFT
    back = 0.0
    if inside:
        slopes = INSIDE_SLOPES
        turns = INSIDE_TURNS
        lift = 0.0
        back = GRASP_BACK
    before = np.array([0.0, 0.0, lift])
    gripper_goals = []
    for slope, turn, standoff in product(slopes, turns, STANDOFFS):
        approach = _direction(point, origin, slope, turn)
        spot = point - standoff * approach
        if _is_nearest(spot, standoff, neighbors):
            gripper_goals.append(GripperGoal(spot, approach, None, before, back))
    return gripper_goals


def goals_aside(point: FloatArray, origin: FloatArray, neighbors: FloatArray) -> list[GripperGoal]:
    """Return poses beside and above an object that stands behind another one; arguments as `pick_gripper_goals`."""
    gripper_goals = []
    for slope, turn in product(INSIDE_SLOPES[:3], INSIDE_TURNS):
        approach = _direction(point, origin, slope, turn)
        left = np.array([-approach[1], approach[0], 0.0]) / np.hypot(approach[0], approach[1])
        for across, up in ((1.0, 0.0), (-1.0, 0.0), (0.7, 0.7), (-0.7, 0.7), (0.0, 1.0)):
            spot = point + ASIDE * (across * left + np.array([0.0, 0.0, up]))
            if _is_nearest(spot, ASIDE, neighbors):
                gripper_goals.append(GripperGoal(spot, approach, None, np.zeros(3), GRASP_BACK))
    return gripper_goals


def _is_nearest(spot: FloatArray, distance: float, neighbors: FloatArray) -> bool:
    """Return whether all neighbors are clearly farther from a gripper point than the target."""
    return not (np.linalg.norm(neighbors - spot, axis=1) < distance + NEIGHBOR_GAP).any()


def handle_gripper_goals(point: FloatArray, origin: FloatArray, sides: Sequence[FloatArray]) -> list[GripperGoal]:
    """Return poses in which the magic grasp takes a handle at a point (3,), approached from a place on the floor (2,).

    The gripper waits in one of the directions `sides` from the handle, each of length 1 and shape (3,).
    """
    slopes = (np.radians(20.0), np.radians(50.0), np.radians(0.0))
    return [
        GripperGoal(point + 0.09 * side, _direction(point, origin, slope, turn), None, 0.05 * side)
        for side, slope, turn in product(sides, slopes, GRASP_TURNS)
    ]


def place_gripper_goals(
    point: FloatArray, origin: FloatArray, half: float, offset: FloatArray, turn: FloatArray, inside: bool
) -> list[GripperGoal]:
    """Return poses that hold an object upright, a little above the goal of its middle, shape (3,).

    The robot comes from `origin` on the floor, shape (2,). The object is `half` of its height above what it will stand
    on; `offset` (3,) and `turn` (3, 3) are how the hand holds it, see `Hand`. `inside`: whether the goal is behind a
    door.
    """
    backs: tuple[float, ...] = (0.0, GRASP_BACK)
    higher: tuple[float, ...] = (0.0,)
    lifts: tuple[float, ...] = (LIFT, HIGH_LIFT)
    if inside:
        backs = (GRASP_BACK, 0.6)
        higher = (0.0, 0.03)
        lifts = (0.02,)
    up = np.array([0.0, 0.0, 1.0])

    # With the object upright the hand may still turn about the vertical. It comes from the robot's side: forward is its
    # x axis, or its z axis where it points down.
    axes = turn.T
    ahead = axes[:, 0] + axes[:, 2]
    facing = np.arctan2(point[1] - origin[1], point[0] - origin[0]) - np.arctan2(ahead[1], ahead[0])
    lowest = min(WRIST[0] * axes[2, 0] - WRIST[1], FINGERS[0] * axes[2, 0] - FINGERS[1])
    found = []
    for about, back, more, lift in product(PLACE_TURNS, backs, higher, lifts):
        held = about_z(facing + about) @ axes
        height = max(HEIGHT, HAND_GAP - lowest - half + (held @ offset)[2])
        middle = point + (height + more) * up
        found.append(GripperGoal(middle - held @ offset, held[:, 0], held, lift * up, back))
    return found


def _direction(point: FloatArray, origin: FloatArray, slope: float, turn: float) -> FloatArray:
    heading = np.arctan2(point[1] - origin[1], point[0] - origin[0]) + turn
    return np.array([np.cos(heading) * np.cos(slope), np.sin(heading) * np.cos(slope), -np.sin(slope)])


GRASP_ATTEMPTS = 3
"""How often the oracle tries to grasp an object or a handle in one skill."""
GRASP_MARGIN = 0.002
"""Safety margin of the grasp radius in [m]: the robot still moves when its hand closes."""


def pick(view: View) -> Motion:
    """Pick the target."""
    target = int(view.state.target[0])
    for _ in range(GRASP_ATTEMPTS):
        yield from unjam(view)
        query = CollisionQuery(view.simulator)
        plan = plan_pick(query, view.state.object[0].copy(), target, view.base, goal=view.state.goal[0])
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
    simulator = view.simulator
    gripper = view.state.gripper[0]
    distance = np.linalg.norm(simulator.middles - gripper, axis=1)
    handle_near = np.linalg.norm(simulator.handles - gripper, axis=1).min() <= GRASP_RADIUS + GRASP_MARGIN
    return bool(distance.argmin() == target and distance[target] < GRASP_RADIUS - GRASP_MARGIN and not handle_near)


def plan_pick(
    query: CollisionQuery,
    point: FloatArray,
    target: int,
    base: Pose,
    stands: list[Pose] | None = None,
    goal: FloatArray | None = None,
) -> ReachPlan | None:
    """Return where to stand and how to reach an object; `stands` None: what one turn and one drive reach.

    A hand that keeps the object's attitude takes it as it can be placed at its goal, shape (3,).
    """
    simulator = query.simulator
    neighbors = np.concatenate([np.delete(simulator.middles, target, axis=0), simulator.handles])
    neighbors = neighbors[np.linalg.norm(neighbors - point, axis=1) < 0.5]
    inside = query.is_behind_door(point)
    origin = np.array([base.x, base.y])
    gripper_goals = pick_gripper_goals(point, origin, neighbors, inside)
    if not inside and goal is not None and simulator.scene.options.grasp == "kept" and query.is_behind_door(goal):
        level = [each for each in gripper_goals if each.approach[2] >= -np.sin(LOW)]
        plan = plan_from(query, base, level, point, stands, target)
        if plan is not None and plan.free:
            return plan
    firm = target
    if inside:
        firm = -1  # through a door there is but one way in, and the target may give way a little
    return plan_from(query, base, gripper_goals, point, stands, firm, lambda: goals_aside(point, origin, neighbors))


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
    query = CollisionQuery(view.simulator)
    now = view.base
    end = plan.entry
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


SPEED = 0.40
"""Of the handle in [m/s]."""
NEAREST = 0.62
FARTHEST = 0.85
"""Distances along the floor between which the base keeps the gripper in [m]."""
HANDLE_BACK = 0.15
"""Distance the robot backs off from a released handle, in [m]."""


def articulate(view: View, goal: float, enough: float) -> Motion:
    """Move the skill goal's drawer or door to within `enough` of `goal`. In [m] or [rad]."""
    link = int(view.state.link[0])
    for _ in range(GRASP_ATTEMPTS):
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
    yield from together(turn_and_go(view, view.base.yaw, -HANDLE_BACK), rest_arm(view))


def _near(view: View) -> bool:
    """Return whether the handle can be grasped."""
    return float(np.linalg.norm(view.state.handle[0] - view.state.gripper[0])) < GRASP_RADIUS - GRASP_MARGIN


def plan_handle(query: CollisionQuery, link: int, base: Pose, stands: list[Pose] | None = None) -> ReachPlan | None:
    """Return where to stand and how to reach a handle."""
    point = query.simulator.handles[link]
    origin = np.array([base.x, base.y])
    gripper_goals = handle_gripper_goals(point, origin, _sides(query, link, point, origin))
    return plan_from(query, base, gripper_goals, point, stands)


def _sides(query: CollisionQuery, link: int, point: FloatArray, origin: FloatArray) -> list[FloatArray]:
    """Return directions from a handle in which the hand may wait: in front of a drawer; at a door's face or edge."""
    handles = query.simulator.scene.handles
    if handles.sign[link] == 0.0:
        return [handles.slide[link]]
    out = handles.at(float(query.simulator.links[link]) + 0.01)[link] - point
    radial = point - handles.origin[link]
    toward = np.array([*(origin - point[:2]), 0.0])
    face, edge, robot = (each / np.linalg.norm(each) for each in (out, radial * (1.0, 1.0, 0.0), toward))
    return [robot, (face + edge) / np.sqrt(2.0), edge, face]


def _carry(view: View, link: int, goal: float, enough: float) -> Motion:
    """Move the held handle: a target point moves along the handle's path, gripper and base follow it."""
    handles = view.simulator.scene.handles
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

        # The base drives as fast as the handle, and keeps it within reach.
        ahead_of_it = handles.at(wanted + 0.02 * direction)[link] - handles.at(wanted)[link]
        along = view.base.to_local(ahead_of_it + np.array([view.base.x, view.base.y, 0.0]))
        local = view.base.to_local(handles.at(wanted)[link])
        far = float(np.hypot(local[0], local[1]))
        bearing = float(np.arctan2(local[1], local[0]))
        forward = SPEED * along[0] / max(float(np.linalg.norm(along)), 1e-9)
        if far > FARTHEST:
            forward += 3.0 * (far - FARTHEST)
        elif far < NEAREST:
            forward += 3.0 * (far - NEAREST)
        turn = 0.0
        if abs(bearing) > 0.6:
            turn = float(np.clip(bearing, -0.3, 0.3))

        # The arm makes up for the rest.
        arm = reach_for(view, handles.at(wanted)[link], 0.7, tool)
        yield view.action(float(np.clip(forward, -0.7, 0.7)), turn, arm)


HEIGHT = 0.015
"""Height above the goal at which the object is released in [m]."""
WRIST = (-0.15, 0.052)
FINGERS = (0.04, 0.03)
"""Parts of the hand: distance along its x axis from the gripper point, and how far they extend across it, in [m]."""
HAND_GAP = 0.006
"""Smallest height of the hand above a surface in [m]. Flat objects drop the rest."""
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
    hand = query.simulator.hand
    half = WRIST[1]
    turn = hand.turn
    if hand.held >= 0:
        kind = get_kind(query.simulator.scene.placements[hand.held].kind)
        half = kind.half[2]
        if kind.axis == "none":  # it lies as well in any attitude
            turn = np.eye(3)
    origin = np.array([base.x, base.y])
    inside = query.is_behind_door(goal)
    plan = plan_from(query, base, place_gripper_goals(goal, origin, half, hand.offset, turn, inside), goal, stands)
    if plan is None:  # a level hand, whatever the attitude of the object
        level = place_gripper_goals(goal, origin, half, hand.offset, np.eye(3), inside)
        plan = plan_from(query, base, level, goal, stands)
    return plan


BEST_DISTANCE = 0.72
"""Best distance from an object or goal, along the floor in [m]. From a handle it is `Articulated.scripted_distance`."""
RESTING_ARM_HEIGHT = 0.7
"""Height in [m] below which furniture cannot touch the resting arm."""
ARM_REACH = 0.75
"""Reach of the resting arm with a held object in [m]."""
CLOSENESS = 0.06
"""Meters of distance per unit of `arm_cost` in the choice of a standing place."""
STAND_DISTANCE = 0.3
"""Smallest distance of the next standing place from one that could not be reached, in [m]."""
MOST_STANDS = 10
"""Largest number of standing places tried."""
STEPS_AHEAD = (0.0, 0.15, 0.3, 0.45)
"""Distances that the next skill may drive on from a standing place, in [m]."""


def navigate(view: View) -> Motion:
    """Drive to a place from which the next skill works."""
    skill_goal = view.world.skill_goal(view.number)
    route = skill_goal.route
    assert route is not None
    goals = np.nonzero(route.values == 0.0)[0]
    aim = np.array(skill_goal.aim)
    cost = arm_cost(view.simulator.scene.apartment, tuple(sorted(open_links(view.simulator).items())))
    best = BEST_DISTANCE
    following = SKILLS[skill_goal.toward]
    if issubclass(following, Articulated):
        best = following.scripted_distance
    stands = list(around(route.space, goals, aim, best, MOST_STANDS, CLOSENESS * (cost - 1.0)))
    while stands:
        plan = _plan(view, skill_goal, stands)
        stand = stands[0]
        if plan is not None:
            stand = plan.base
        cell, _ = route.space.nearest(np.array([[stand.x, stand.y]]))
        way = route.space.distances(cell, cost).path(np.array([view.base.x, view.base.y]))
        yield from follow(view, np.concatenate([way, [[stand.x, stand.y]]]))
        if _apart(view.base, stand) < STAND_DISTANCE:
            break
        stands = [other for other in stands if _apart(other, stand) > STAND_DISTANCE]  # it cannot be reached
    yield from turn_to(view, float(np.arctan2(aim[1] - view.base.y, aim[0] - view.base.x)))


def _apart(one: Pose, other: Pose) -> float:
    return float(np.hypot(one.x - other.x, one.y - other.y))


@lru_cache(maxsize=64)
def arm_cost(apartment: Apartment, opened: tuple[tuple[str, float], ...]) -> FloatArray:
    """Return the cost of a meter at each free cell: higher where the resting arm may touch tall furniture."""
    space = free_space(apartment, dict(opened))
    tall = apartment_footprints(apartment, dict(opened), low=RESTING_ARM_HEIGHT)
    near = occupancy.clearance(space.centers, tall)
    return 1.0 + 5.0 * np.clip((ARM_REACH - near) / (ARM_REACH - 0.3), 0.0, 1.0)


def _plan(view: View, skill_goal: SkillGoal, stands: list[Pose]) -> ReachPlan | None:
    """Return the skill's own plan from the first standing place that works, each with a step ahead or back."""
    best: ReachPlan | None = None
    query = CollisionQuery(view.simulator)
    aim = np.array(skill_goal.aim)
    for stand in stands:
        places = list(ahead(stand, aim, STEPS_AHEAD, (0.0,)))
        if skill_goal.toward == Verb.PICK:
            goal = np.array(skill_goal.goal)
            plan = plan_pick(query, view.state.object[0].copy(), skill_goal.target, stand, places, goal)
        elif skill_goal.toward == Verb.PLACE:
            plan = plan_place(query, aim, stand, places)
        else:
            plan = plan_handle(query, skill_goal.link, stand, places)
        if plan is not None and (best is None or plan.depth < best.depth):
            best = replace(plan, base=stand)
        if best is not None and best.free:
            break
    return best


MOTIONS: dict[str, Callable[[View], Motion]] = {Verb.PICK: pick, Verb.PLACE: place, Verb.NAVIGATE: navigate}
"""Motion by skill; those that open or close a container share `articulate`."""


def motion_of(skill: Skill, view: View) -> Motion:
    """Return the motion of a skill in a lane."""
    if isinstance(skill, Articulated):
        return articulate(view, skill.scripted_goal, skill.scripted_tolerance)
    return MOTIONS[skill.name](view)


class Oracle(SkillAgent):
    """Sense, plan, act with full knowledge of the world: geodesic paths and inverse kinematics."""

    needs_scan = False
    is_oracle = True

    def __init__(self) -> None:
        """Start without plans; a plan is made when a skill begins."""
        self._running: dict[int, tuple[View, Motion]] = {}

    def begin(self, world: VectorSimulator, lane: int, skill: Skill) -> None:
        """See `SkillAgent.begin`."""
        base_speed = world.simulator(lane).base_speed(skill.base_speed)
        view = View(world.sense(np.array([lane])), world, lane, base_speed)
        self._running[lane] = (view, motion_of(skill, view))

    def act(
        self, world: VectorSimulator, lanes: IntArray, skill: Skill, state: PrivilegedState, progress: SkillProgress
    ) -> FloatArray:
        """See `SkillAgent.act`. After the end of a motion the robot stands still, or signals "stop"."""
        actions = np.zeros((len(lanes), ROBOT.action_size))
        for row, lane in enumerate(lanes.tolist()):
            view, motion = self._running[lane]
            view.state = state[row : row + 1]
            action = next(motion, None)
            if action is not None:
                actions[row] = action
                actions[row, ROBOT.action.stop] = -1.0  # it knows better than the map where to stop
            elif skill.name == Verb.NAVIGATE:
                actions[row, ROBOT.action.stop] = 1.0
        return actions
