"""The state of many lanes as arrays: robot, held object, the skill's goal, a scan of the surroundings, neighbors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from perdure.home.sim.arrays import BoolArray, FloatArray, IntArray, Rows
from perdure.home.sim.hand import GRASP_RADIUS
from perdure.home.sim.occupancy import Geodesic, moving_footprints, static_footprints
from perdure.home.sim.pieces import Apartment
from perdure.home.sim.robot import ROBOT
from perdure.home.sim.simulator import Simulator


@dataclass(frozen=True)
class SkillGoal:
    """The goal of a skill: the object to pick or place, its goal position, the handle to open or close."""

    target: int = 0
    """Number of the object in the scene."""
    goal: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Its goal position in the room in [m]."""
    link: int = -1
    """Number of the drawer or door in `Scene.links`, -1 when none is meant."""
    toward: str = "pick"
    """For navigation: the skill that follows."""
    aim: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """What navigation should face, in the room in [m]."""
    route: Geodesic | None = None
    """The way to where navigation should end."""
    front: tuple[float, float] = (0.0, 0.0)
    """Direction that the furniture at the object (for place: at the goal) faces, a unit vector in the room."""


@dataclass(frozen=True)
class PrivilegedState(Rows):
    """The state of n lanes. Room frame: x east, y north, z up; base frame: x forward, y left, z up from the floor.

    All lengths in [m], angles in [rad], speeds in [m/s] and [rad/s].
    """

    base: FloatArray
    """Base in the room: x, y, heading. Shape (n, 3)."""
    base_velocity: FloatArray
    """Forward, to the left, turning. Shape (n, 3)."""
    arm: FloatArray
    """Arm joint angles. Shape (n, joints)."""
    arm_target: FloatArray
    """Targets of the arm's servos. Shape (n, joints)."""
    gripper_in_base: FloatArray
    """The gripper point in the base frame. Shape (n, 3)."""
    gripper_rotation: FloatArray
    """Axes of the gripper in the base frame, one per column. Shape (n, 3, 3)."""
    gripper: FloatArray
    """The gripper point in the room. Shape (n, 3)."""
    gripper_velocity: FloatArray
    """Of the gripper point in the room: its way since the last step times the control rate. Shape (n, 3)."""
    held: IntArray
    """Number of the object in the gripper, -1 when there is none. Shape (n,)."""
    held_link: IntArray
    """Number of the link whose handle is held, -1 when there is none. Shape (n,)."""
    hold_error: FloatArray
    """Distance of a held object from where the hand holds it, or of a held handle from the gripper point, 0 with an
    empty hand. Shape (n,)."""
    target: IntArray
    """The skill goal's object. Shape (n,)."""
    object: FloatArray
    """Its middle in the room. Shape (n, 3)."""
    object_up: FloatArray
    """Its own z axis in the room. Shape (n, 3)."""
    goal: FloatArray
    """Its goal position. Shape (n, 3)."""
    link: IntArray
    """The skill goal's drawer or door, -1 when there is none. Shape (n,)."""
    handle: FloatArray
    """Its handle in the room, the room's origin when there is none. Shape (n, 3)."""
    link_position: FloatArray
    """How far it is open, in [m] or [rad]. Shape (n,)."""
    link_velocity: FloatArray
    """Shape (n,)."""
    aim: FloatArray
    """What navigation should face, in the room. Shape (n, 3)."""
    way: FloatArray
    """Length of the way to the region in which navigation should end, 0 inside it or without one. Shape (n,)."""
    waypoint: FloatArray
    """A point of that way half a meter ahead, on the floor; the base itself without one. Shape (n, 3)."""
    front: FloatArray
    """Direction that the skill goal's furniture faces, in the room. Shape (n, 3)."""
    facing_error: FloatArray
    """By how much the robot would have to turn to the left to face the aim. Shape (n,)."""
    scan: FloatArray
    """Ranges from the base to obstacles, all `SCAN_RANGE` where no scan was requested. Shape (n, BEAMS)."""
    neighbors: FloatArray
    """From the object to its nearest neighbors, in the room; 0 where nothing is near. Shape (n, NEIGHBORS, 3)."""
    neighbor_distance: FloatArray
    """From the gripper point to the nearest object other than the target, inf without one. Shape (n,)."""
    handle_distance: FloatArray
    """From the gripper point to the nearest handle, inf without one. Shape (n,)."""
    stopped: BoolArray
    """Whether the robot said in the last step that it has arrived; False when it got a new skill goal. Shape (n,)."""
    contact_force: FloatArray
    """Largest normal force at the arm, its hand and what it holds in the last physics step, in [N]. Shape (n,)."""
    diverged: BoolArray
    """Whether the simulation diverged in this step; the lane was reset to its episode's start. Shape (n,)."""

    @property
    def empty_hand(self) -> BoolArray:
        """Whether the gripper holds neither an object nor a handle. Shape (n,)."""
        return (self.held < 0) & (self.held_link < 0)

    @property
    def holds_target(self) -> BoolArray:
        """Whether the gripper holds the target. Shape (n,)."""
        return np.asarray(self.held == self.target)

    @property
    def grasp_is_right(self) -> BoolArray:
        """Whether the magic grasp would take the target (see `Simulator.grasp`). Shape (n,)."""
        nearer = norm(self.object - self.gripper) < self.neighbor_distance
        return nearer & (self.handle_distance > GRASP_RADIUS)

    @property
    def object_to_goal(self) -> FloatArray:
        """d_o^g: distance from the object to its goal in [m]. Shape (n,)."""
        return norm(self.object - self.goal)

    def in_base(self, points: FloatArray) -> FloatArray:
        """Return points of the room in the base frame. Shape (n, 3) -> (n, 3)."""
        origin = np.concatenate([self.base[:, :2], np.zeros((len(self), 1))], axis=1)
        return turn(points - origin, -self.base[:, 2])

    def turned_to_base(self, vectors: FloatArray) -> FloatArray:
        """Return vectors of the room along the axes of the base. Shape (n, 3) -> (n, 3)."""
        return turn(vectors, -self.base[:, 2])

    def turned_to_gripper(self, vectors: FloatArray) -> FloatArray:
        """Return vectors of the room along the axes of the gripper. Shape (n, 3) -> (n, 3)."""
        in_base = self.turned_to_base(vectors)
        # Written out: a matrix product may round differently for one lane than for many.
        axes = self.gripper_rotation
        return in_base[:, :1] * axes[:, 0] + in_base[:, 1:2] * axes[:, 1] + in_base[:, 2:] * axes[:, 2]


def turn(vectors: FloatArray, angle: FloatArray) -> FloatArray:
    """Return vectors turned about the z axis. Shapes (n, 3), (n,) -> (n, 3)."""
    cos = np.cos(angle)
    sin = np.sin(angle)
    x = vectors[:, 0]
    y = vectors[:, 1]
    turned = np.empty((len(vectors), 3))
    turned[:, 0] = cos * x - sin * y
    turned[:, 1] = sin * x + cos * y
    turned[:, 2] = vectors[:, 2]
    return turned


def norm(vectors: FloatArray) -> FloatArray:
    """Return lengths of vectors; the same bits for one row as for many. Shape (n, 3) -> (n,)."""
    x = vectors[:, 0]
    y = vectors[:, 1]
    z = vectors[:, 2]
    return np.sqrt(x * x + y * y + z * z)


def wrap(angle: FloatArray) -> FloatArray:
    """Return angles brought into [-pi, pi)."""
    return np.mod(angle + np.pi, 2.0 * np.pi) - np.pi


def up_axis(quaternion: FloatArray) -> FloatArray:
    """Return the z axis of rotations given as (w, x, y, z). Shape (n, 4) -> (n, 3)."""
    w, x, y, z = quaternion.T
    up = np.empty((len(quaternion), 3))
    up[:, 0] = 2.0 * (x * z + w * y)
    up[:, 1] = 2.0 * (y * z - w * x)
    up[:, 2] = 1.0 - 2.0 * (x * x + y * y)
    return up


_NO_OBJECT = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
CELLS_AHEAD = 10
"""Look-ahead of the waypoint in cells of 0.05 m."""


def read_state(
    lanes: Sequence[Simulator],
    goals: Sequence[SkillGoal],
    known: Mapping[str, Any],
    scan_reach: FloatArray,
    neighbors: BoolArray,
) -> PrivilegedState:
    """Return the present state of n lanes.

    Args:
        lanes: Their simulators.
        goals: Their skill goals.
        known: What a simulator does not tell, by name of the entry of `PrivilegedState`.
        scan_reach: Range of each lane's scan in [m], 0 for none. Shape (n,).
        neighbors: Whether the surroundings of each lane's target are looked at. Shape (n,).
    """
    n = len(lanes)
    gripper = known["gripper"]

    # Robot, target object, drawer or door, and what is held, from each lane's simulator.
    robot = np.empty((n, len(ROBOT.joints)))
    velocity = np.empty((n, 3))
    axes = np.empty((n, 3, 3))
    pose = np.empty((n, len(_NO_OBJECT)))
    handle = np.zeros((n, 3))
    link_position = np.zeros(n)
    link_velocity = np.zeros(n)
    hold = gripper.copy()
    for row, (lane, goal) in enumerate(zip(lanes, goals, strict=True)):
        robot[row] = lane.robot
        velocity[row] = lane.robot_velocity[:3]
        axes[row] = lane.gripper_axes
        pose[row] = _NO_OBJECT
        if 0 <= goal.target < len(lane.scene.placements):
            pose[row] = lane.object(goal.target)[0]
        if goal.link >= 0:
            handle[row] = lane.handles[goal.link]
            link_position[row] = lane.links[goal.link]
            link_velocity[row] = lane.qvel[lane.scene.link_qvel[goal.link]]
        if lane.held >= 0:
            hold[row] = lane.object(lane.held)[0][:3] - lane.gripper_axes @ lane.hand.offset
        elif lane.held_link >= 0:
            hold[row] = lane.handles[lane.held_link]

    # The way to the region in which navigation should end.
    base = robot[:, :3]
    flat = np.zeros((n, 1))
    floor = np.concatenate([base[:, :2], flat], axis=1)
    way = np.zeros(n)
    waypoint = floor.copy()
    for row, (goal, (x, y, _)) in enumerate(zip(goals, base.tolist(), strict=True)):
        if goal.route is not None:
            way[row], waypoint[row, 0], waypoint[row, 1] = goal.route.ahead(x, y, CELLS_AHEAD)

    # From the room's axes to the base's.
    moving = turn(np.concatenate([velocity[:, :2], flat], axis=1), -base[:, 2])
    moving[:, 2] = velocity[:, 2]
    cos = np.cos(base[:, 2, None])
    sin = np.sin(base[:, 2, None])
    rotation = axes.copy()
    rotation[:, 0] = cos * axes[:, 0] + sin * axes[:, 1]
    rotation[:, 1] = cos * axes[:, 1] - sin * axes[:, 0]

    target = np.array([goal.target for goal in goals], dtype=np.int64)
    aim = np.array([goal.aim for goal in goals]).reshape(n, 3)
    near, neighbor_distance, handle_distance = look_around(lanes, target, gripper, neighbors)
    return PrivilegedState(
        **known,
        neighbors=near,
        neighbor_distance=neighbor_distance,
        handle_distance=handle_distance,
        base=base,
        base_velocity=moving,
        arm=robot[:, ROBOT.arm_columns],
        gripper_in_base=turn(gripper - floor, -base[:, 2]),
        gripper_rotation=rotation,
        held=np.array([lane.held for lane in lanes], dtype=np.int64),
        held_link=np.array([lane.held_link for lane in lanes], dtype=np.int64),
        hold_error=norm(hold - gripper),
        target=target,
        object=pose[:, :3],
        object_up=up_axis(pose[:, 3:]),
        goal=np.array([goal.goal for goal in goals]).reshape(n, 3),
        link=np.array([goal.link for goal in goals], dtype=np.int64),
        handle=handle,
        link_position=link_position,
        link_velocity=link_velocity,
        aim=aim,
        way=way,
        waypoint=waypoint,
        front=np.array([(*goal.front, 0.0) for goal in goals]).reshape(n, 3),
        facing_error=wrap(np.arctan2(aim[:, 1] - base[:, 1], aim[:, 0] - base[:, 0]) - base[:, 2]),
        scan=scan(lanes, base, scan_reach),
    )


def padded(parts: Sequence[FloatArray], fill: float | FloatArray, least: int = 1) -> FloatArray:
    """Return arrays of different lengths as one, `least` or more rows each. Shapes (k_i, *) -> (n, k, *)."""
    most = max(least, *map(len, parts))
    result = np.full((len(parts), most, *parts[0].shape[1:]), fill)
    for row, part in zip(result, parts, strict=True):
        row[: len(part)] = part
    return result


BEAMS = 24
"""Our choice: few enough for a small network; the Fetch's own laser has 662 over 220 degrees."""
SCAN_RANGE = 5.0
"""Our choice: ranges beyond are cut, in [m]."""
SCAN_ANGLES: FloatArray = np.linspace(0.0, 2.0 * np.pi, BEAMS, endpoint=False)
"""Of the beams, from straight ahead to the left."""
OPEN_STEP = 0.01
"""Drawers and doors count as open by multiples of it in [m] or [rad], so that their footprints are found again."""
NOT_ZERO = 1.1e-12
"""Added to directions of beams, because one along a side would divide by zero."""
_NOTHING = np.array([0.0, 0.0, -1.0, -1.0, 1.0, 0.0])
"""A rectangle that no beam hits: x, y, half lengths, cosine and sine of its heading."""


def scan(lanes: Sequence[Simulator], base: FloatArray, reach: FloatArray) -> FloatArray:
    """Return the ranges in [m] from the robots' centers to obstacles of the base. Shape (n, BEAMS).

    A Fetch makes such a scan from its laser, which looks 0.29 m above the floor, and from its head camera, which sees
    table tops above and shelves below. Everything that reaches between 0.05 and 1.5 m counts, with drawers and doors
    where they are now; loose objects do not.

    Args:
        lanes: Their simulators.
        base: x, y, heading of the robots. Shape (n, 3).
        reach: How far each lane looks in [m]; `SCAN_RANGE` is returned for what is farther. Shape (n,).
    """
    ranges = np.full((len(lanes), BEAMS), SCAN_RANGE)
    for each in np.unique(reach[reach > 0.0]).tolist():  # who looks far must not make the others' search longer
        rows = np.flatnonzero(reach == each)
        some = [lanes[row] for row in rows.tolist()]
        positions = [np.round(lane.links / OPEN_STEP) * OPEN_STEP for lane in some]
        shapes = [_outline(lane.scene.apartment, q.tobytes()) for lane, q in zip(some, positions, strict=True)]
        ranges[rows] = _ranges(padded(shapes, _NOTHING), base[rows], each)
    return ranges


@lru_cache(maxsize=4096)
def _outline(apartment: Apartment, positions: bytes) -> FloatArray:
    """Return the footprints of furniture, drawers and doors: x, y, half lengths, cosine, sine. Shape (k, 6)."""
    shapes = np.concatenate([static_footprints(apartment), moving_footprints(apartment, np.frombuffer(positions))])
    return np.column_stack([shapes[:, :4], np.cos(shapes[:, 4]), np.sin(shapes[:, 4])])


def _ranges(rectangles: FloatArray, base: FloatArray, reach: float) -> FloatArray:
    """Return the ranges to rectangles (n, k, 6), `SCAN_RANGE` where none is within reach. Shape (n, BEAMS)."""
    away = np.hypot(rectangles[..., 0] - base[:, :1], rectangles[..., 1] - base[:, 1:2])
    near = away - np.hypot(rectangles[..., 2], rectangles[..., 3]) <= reach
    order = np.argsort(~near, axis=1, kind="stable")[:, : max(int(near.sum(axis=1).max()), 1)]
    boxes = np.take_along_axis(rectangles, order[:, :, None], axis=1)[:, None]  # (n, 1, most, 6)
    x, y, half_x, half_y, cos, sin = (boxes[..., k] for k in range(6))

    # Where the robot is in the frame of each rectangle.
    dx = base[:, 0, None, None] - x
    dy = base[:, 1, None, None] - y
    at_x = cos * dx + sin * dy
    at_y = cos * dy - sin * dx

    # How far a beam goes until it has covered 1 m along each axis of a rectangle.
    angle = (base[:, 2, None] + SCAN_ANGLES)[:, :, None]
    beam_x = np.cos(angle)
    beam_y = np.sin(angle)
    slow_x = 1.0 / (beam_x * cos + beam_y * sin + NOT_ZERO)
    slow_y = 1.0 / (beam_y * cos - beam_x * sin + NOT_ZERO)

    # A beam is inside a rectangle while it is between both pairs of opposite sides.
    middle_x = -at_x * slow_x
    spread_x = half_x * np.abs(slow_x)
    middle_y = -at_y * slow_y
    spread_y = half_y * np.abs(slow_y)
    enter = np.maximum(np.maximum(middle_x - spread_x, middle_y - spread_y), 0.0)
    leave = np.minimum(middle_x + spread_x, middle_y + spread_y)
    ranges = np.where(leave >= enter, enter, SCAN_RANGE).min(axis=2)
    return np.where(ranges <= reach, ranges, SCAN_RANGE)


NEIGHBORS = 2
"""Number of nearest neighbors in the state."""
NEIGHBORHOOD = 0.5
"""Largest distance of a neighbor from the target in [m]."""


def look_around(
    lanes: Sequence[Simulator], targets: IntArray, grippers: FloatArray, wanted: BoolArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return neighbors, their distance and that of handles of n lanes; nothing near where it is not wanted.

    The magic grasp takes the nearest handle within reach, else the nearest object, so a robot that picks must know
    them; its head camera would show them. A target that a scene does not have has no neighbors but handles.
    """
    n = len(lanes)
    neighbors = np.zeros((n, NEIGHBORS, 3))
    object_distance = np.full(n, np.inf)
    handle_distance = np.full(n, np.inf)
    rows = np.flatnonzero(wanted)
    if not len(rows):
        return neighbors, object_distance, handle_distance
    lanes = [lanes[row] for row in rows.tolist()]
    targets = targets[rows]
    grippers = grippers[rows]

    # Take the target out of the objects: what is infinitely far is never near.
    each = np.arange(len(rows))
    middles = padded([lane.middles for lane in lanes], np.inf, NEIGHBORS + 1)
    known = (targets >= 0) & (targets < [len(lane.scene.placements) for lane in lanes])
    target = np.where(known, targets, 0)
    at = np.where(known[:, None], middles[each, target], 0.0)
    middles[each, target] = np.inf
    middles[~known] = np.inf

    # The objects nearest to where the target is, and what is nearest to the gripper.
    apart = middles - at[:, None]
    away = norm(apart.reshape(-1, 3)).reshape(len(each), -1)
    nearest = np.argsort(away, axis=1, kind="stable")[:, :NEIGHBORS]
    near = np.take_along_axis(away, nearest, axis=1) <= NEIGHBORHOOD
    neighbors[rows] = np.where(near[:, :, None], apart[each[:, None], nearest], 0.0)
    object_distance[rows] = _nearest(middles, grippers)
    handle_distance[rows] = _nearest(padded([lane.handles for lane in lanes], np.inf), grippers)
    return neighbors, object_distance, handle_distance


def _nearest(points: FloatArray, grippers: FloatArray) -> FloatArray:
    """Return the distance from each gripper (n, 3) to the nearest of its points (n, k, 3). Shape (n,)."""
    distance = norm((points - grippers[:, None]).reshape(-1, 3)).reshape(len(points), -1)
    return np.asarray(distance.min(axis=1))
