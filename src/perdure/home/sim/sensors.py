"""The state of many lanes as arrays: robot, held object, the skill's goal, a scan of the surroundings, neighbors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np

from perdure.home.sim.arrays import BoolArray, FloatArray, IntArray
from perdure.home.sim.occupancy import Geodesic, moving_footprints, static_footprints
from perdure.home.sim.pieces import Apartment
from perdure.home.sim.scene import CONTROL_HZ, Handles, Scene
from perdure.home.sim.simulator import ARM_FROM, ARM_TO, GRASP_RADIUS, TORSO, Simulator


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
class PrivilegedState:
    """The state of n lanes. Room frame: x east, y north, z up; base frame: x forward, y left, z up from the floor.

    All lengths in [m], angles in [rad], speeds in [m/s] and [rad/s].
    """

    base: FloatArray
    """Base in the room: x, y, heading. Shape (n, 3)."""
    base_velocity: FloatArray
    """Forward, to the left, turning. Shape (n, 3)."""
    torso: FloatArray
    """Height of the torso joint. Shape (n,)."""
    arm: FloatArray
    """Arm joint angles. Shape (n, 7)."""
    arm_velocity: FloatArray
    """Shape (n, 7)."""
    arm_target: FloatArray
    """Targets of the arm's servos. Shape (n, 7)."""
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
    """Distance of what is held (object's middle or handle) from the gripper point, 0 with an empty hand. Shape (n,)."""
    target: IntArray
    """The skill goal's object. Shape (n,)."""
    object: FloatArray
    """Its middle in the room. Shape (n, 3)."""
    object_up: FloatArray
    """Its own z axis in the room. Shape (n, 3)."""
    object_velocity: FloatArray
    """Linear, in the room. Shape (n, 3)."""
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

    def __len__(self) -> int:
        """Number of lanes."""
        return len(self.torso)

    def __getitem__(self, lanes: IntArray | slice | BoolArray) -> PrivilegedState:
        """Some of the lanes."""
        return PrivilegedState(*[getattr(self, name)[lanes] for name in _FIELDS])

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


_FIELDS = tuple(each.name for each in fields(PrivilegedState))


def turn(vectors: FloatArray, angle: FloatArray) -> FloatArray:
    """Return vectors turned about the z axis. Shapes (n, 3), (n,) -> (n, 3)."""
    cos, sin = np.cos(angle), np.sin(angle)
    x, y = vectors[:, 0], vectors[:, 1]
    turned = np.empty((len(vectors), 3))
    turned[:, 0], turned[:, 1], turned[:, 2] = cos * x - sin * y, sin * x + cos * y, vectors[:, 2]
    return turned


def norm(vectors: FloatArray) -> FloatArray:
    """Return lengths of vectors; the same bits for one row as for many. Shape (n, 3) -> (n,)."""
    x, y, z = vectors[:, 0], vectors[:, 1], vectors[:, 2]
    return np.sqrt(x * x + y * y + z * z)


def wrap(angle: FloatArray) -> FloatArray:
    """Return angles brought into [-pi, pi)."""
    return np.mod(angle + np.pi, 2.0 * np.pi) - np.pi


def up_axis(quaternion: FloatArray) -> FloatArray:
    """Return the z axis of rotations given as (w, x, y, z). Shape (n, 4) -> (n, 3)."""
    w, x, y, z = quaternion.T
    up = np.empty((len(quaternion), 3))
    up[:, 0], up[:, 1], up[:, 2] = 2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)
    return up


_NO_OBJECT = (np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]), np.zeros(3))


class Readings:
    """Arrays over all lanes; the names are those of `PrivilegedState`."""

    def __init__(self, lanes: int) -> None:
        """Begin with zeros for every lane."""
        self.robot = np.zeros((lanes, ARM_TO))
        self.robot_velocity = np.zeros((lanes, ARM_TO))
        self.arm_target = np.zeros((lanes, 7))
        self.gripper_in_base, self.gripper = np.zeros((lanes, 3)), np.zeros((lanes, 3))
        self.gripper_velocity = np.zeros((lanes, 3))
        self.rotation = np.zeros((lanes, 3, 3))
        self.holds = np.full((lanes, 2), -1, dtype=np.int64)
        self.held_point = np.zeros((lanes, 3))
        self.object, self.object_velocity = np.zeros((lanes, 7)), np.zeros((lanes, 3))
        self.handle, self.link_state = np.zeros((lanes, 3)), np.zeros((lanes, 2))
        self.skill_goal = np.zeros((lanes, 2), dtype=np.int64)
        self.goal, self.aim, self.front = np.zeros((lanes, 3)), np.zeros((lanes, 3)), np.zeros((lanes, 3))
        self.force = np.zeros(lanes)
        self.stopped = np.zeros(lanes, dtype=bool)
        self.diverged = np.zeros(lanes, dtype=bool)
        self._point, self._axes = np.zeros((lanes, 3)), np.zeros((lanes, 3, 3))
        self._target: list[tuple[FloatArray, FloatArray]] = [_NO_OBJECT] * lanes

    def read_robot(self, number: int, lane: Simulator) -> None:
        """Read the joints of one lane's robot, and its gripper."""
        self.robot[number] = lane.robot[:ARM_TO]
        self.robot_velocity[number] = lane.robot_velocity[:ARM_TO]
        self._point[number], self._axes[number] = lane.gripper, lane.gripper_axes

    def move_grippers(self, chosen: IntArray, first: BoolArray) -> None:
        """Update the grippers after the joints were read; their speed is 0 where it is the `first` reading."""
        point, axes, base = self._point[chosen], self._axes[chosen], self.robot[chosen, :3]
        cos, sin = np.cos(base[:, 2]), np.sin(base[:, 2])
        x, y = point[:, 0] - base[:, 0], point[:, 1] - base[:, 1]
        position, rotation = point.copy(), axes.copy()
        position[:, 0], position[:, 1] = cos * x + sin * y, cos * y - sin * x
        cos, sin = cos[:, None], sin[:, None]
        rotation[:, 0], rotation[:, 1] = cos * axes[:, 0] + sin * axes[:, 1], cos * axes[:, 1] - sin * axes[:, 0]
        moved = np.where(first[:, None], 0.0, (point - self.gripper[chosen]) * CONTROL_HZ)
        self.gripper_in_base[chosen], self.rotation[chosen] = position, rotation
        self.gripper[chosen], self.gripper_velocity[chosen] = point, moved

    def take_skill_goal(self, number: int, lane: Simulator, skill_goal: SkillGoal) -> None:
        """Set the skill goal of a lane."""
        self.skill_goal[number] = skill_goal.target, skill_goal.link
        self.stopped[number] = False
        self.goal[number], self.aim[number] = skill_goal.goal, skill_goal.aim
        self.front[number] = *skill_goal.front, 0.0
        known = 0 <= skill_goal.target < len(lane.scene.placements)
        self._target[number] = lane.object(skill_goal.target) if known else _NO_OBJECT
        self.read_skill_goal(number, lane)

    def read_skill_goal(self, number: int, lane: Simulator) -> None:
        """Read the target, the handle and the held object of a lane."""
        target = self._target[number]
        self.object[number], self.object_velocity[number] = target
        link = int(self.skill_goal[number, 1])
        if link >= 0:
            q = lane.qpos[lane.scene.link_qpos[link]]
            self.handle[number] = lane.scene.handles.one(link, float(q))
            self.link_state[number] = q, lane.qvel[lane.scene.link_qvel[link]]
        else:
            self.handle[number], self.link_state[number] = 0.0, 0.0
        self.holds[number] = lane.held, lane.held_link
        if lane.held >= 0:
            self.held_point[number] = lane.object(lane.held)[0][:3]
        elif lane.held_link >= 0:
            q = lane.qpos[lane.scene.link_qpos[lane.held_link]]
            self.held_point[number] = lane.scene.handles.one(lane.held_link, float(q))
        else:
            self.held_point[number] = self.gripper[number]

    def state(
        self, chosen: IntArray, way: FloatArray, waypoint: FloatArray, scan: FloatArray, around: Neighbors
    ) -> PrivilegedState:
        """Return the record for some lanes. Shapes (m,), (m, 3), (m, beams)."""
        robot, velocity, pose = self.robot[chosen], self.robot_velocity[chosen], self.object[chosen]
        base, aim, gripper = robot[:, :3], self.aim[chosen], self.gripper[chosen]
        flat = np.concatenate([velocity[:, :2], np.zeros((len(chosen), 1))], axis=1)
        moving = turn(flat, -base[:, 2])
        moving[:, 2] = velocity[:, 2]
        holds, skill_goal, link = self.holds[chosen], self.skill_goal[chosen], self.link_state[chosen]
        return PrivilegedState(
            base=base,
            base_velocity=moving,
            torso=robot[:, TORSO],
            arm=robot[:, ARM_FROM:ARM_TO],
            arm_velocity=velocity[:, ARM_FROM:ARM_TO],
            arm_target=self.arm_target[chosen],
            gripper_in_base=self.gripper_in_base[chosen],
            gripper_rotation=self.rotation[chosen],
            gripper=gripper,
            gripper_velocity=self.gripper_velocity[chosen],
            held=holds[:, 0],
            held_link=holds[:, 1],
            hold_error=norm(self.held_point[chosen] - gripper),
            target=skill_goal[:, 0],
            object=pose[:, :3],
            object_up=up_axis(pose[:, 3:]),
            object_velocity=self.object_velocity[chosen],
            goal=self.goal[chosen],
            link=skill_goal[:, 1],
            handle=self.handle[chosen],
            link_position=link[:, 0],
            link_velocity=link[:, 1],
            aim=aim,
            way=way,
            waypoint=waypoint,
            front=self.front[chosen],
            facing_error=wrap(np.arctan2(aim[:, 1] - base[:, 1], aim[:, 0] - base[:, 0]) - base[:, 2]),
            scan=scan,
            neighbors=around.from_object,
            neighbor_distance=around.distance,
            handle_distance=around.handle_distance,
            stopped=self.stopped[chosen],
            contact_force=self.force[chosen],
            diverged=self.diverged[chosen],
        )


BEAMS = 24
"""Our choice: few enough for a small network; the Fetch's own laser has 662 over 220 degrees."""
SCAN_RANGE = 5.0
"""Our choice: ranges beyond are cut, in [m]."""
SCAN_ANGLES: FloatArray = np.linspace(0.0, 2.0 * np.pi, BEAMS, endpoint=False)
"""Of the beams, from straight ahead to the left."""
NO_SCAN: FloatArray = np.full(BEAMS, SCAN_RANGE)
OPEN_STEP = 0.01
"""Drawers and doors count as open by multiples of it in [m] or [rad]: a footprint is looked up at each, not always."""
NOT_ZERO = 1.1e-12
"""Added to directions of beams, because one along a side would divide by zero."""
_NOTHING = np.array([0.0, 0.0, -1.0, -1.0, 1.0, 0.0])
"""A rectangle that no beam hits: x, y, half lengths, cosine and sine of its heading."""


class Outlines:
    """Footprints around n lanes, from which it computes scans: ranges from the robot's center to obstacles of the base.

    A Fetch makes such a scan from its laser, which looks 0.29 m above the floor, and from its head camera, which sees
    table tops above and shelves below. Everything that reaches between 0.05 and 1.5 m counts, with drawers and doors
    where they are now; loose objects do not.
    """

    def __init__(self, lanes: int) -> None:
        """Begin with empty rooms."""
        self._apartments: list[Apartment | None] = [None] * lanes
        self._positions: list[FloatArray] = [np.zeros(0)] * lanes
        self._exact = [b""] * lanes
        self._static = [0] * lanes
        self._count = np.zeros(lanes, dtype=np.int64)
        self._rectangles = np.full((lanes, 1, 6), _NOTHING)

    def renew(self, lane: int, apartment: Apartment, positions: FloatArray) -> None:
        """Take over where drawers and doors of a lane are, in the order of the articulations. Shape (links,)."""
        known, exact = self._apartments[lane], positions.tobytes()
        if known is apartment and exact == self._exact[lane]:
            return
        self._exact[lane] = exact
        # Rounded, not compared with the last scan: otherwise a scan would depend on earlier ones.
        positions = np.round(positions / OPEN_STEP) * OPEN_STEP
        if known is not apartment:
            static = static_footprints(apartment)
            self._put(lane, 0, static)
            self._apartments[lane], self._static[lane] = apartment, len(static)
        elif np.array_equal(positions, self._positions[lane]):
            return
        self._positions[lane] = positions
        self._put(lane, self._static[lane], moving_footprints(apartment, positions))

    def scan(self, lanes: IntArray, base: FloatArray, reach: float = SCAN_RANGE) -> FloatArray:
        """Return ranges of some lanes (m,) in [m], `SCAN_RANGE` where nothing is within reach. Shape (m, BEAMS).

        `base` is x, y, heading of their robots, shape (m, 3).
        """
        boxes = self._within(lanes, base, reach)[:, None]  # (m, 1, n, 6)
        x, y, half_x, half_y, cos, sin = (boxes[..., k] for k in range(6))
        dx, dy = base[:, 0, None, None] - x, base[:, 1, None, None] - y
        at_x, at_y = cos * dx + sin * dy, cos * dy - sin * dx
        angle = (base[:, 2, None] + SCAN_ANGLES)[:, :, None]
        beam_x, beam_y = np.cos(angle), np.sin(angle)
        slow_x, slow_y = 1.0 / (beam_x * cos + beam_y * sin + NOT_ZERO), 1.0 / (beam_y * cos - beam_x * sin + NOT_ZERO)
        middle_x, spread_x = -at_x * slow_x, half_x * np.abs(slow_x)
        middle_y, spread_y = -at_y * slow_y, half_y * np.abs(slow_y)
        enter = np.maximum(np.maximum(middle_x - spread_x, middle_y - spread_y), 0.0)
        leave = np.minimum(middle_x + spread_x, middle_y + spread_y)
        ranges = np.where(leave >= enter, enter, SCAN_RANGE).min(axis=2)
        return np.where(ranges <= reach, ranges, SCAN_RANGE)

    def _within(self, lanes: IntArray, base: FloatArray, reach: float) -> FloatArray:
        """Return the rectangles that a beam may reach, filled up with ones that none does. Shape (m, n, 6)."""
        boxes = self._rectangles[lanes, : int(self._count[lanes].max(initial=1))]
        away = np.hypot(boxes[..., 0] - base[:, :1], boxes[..., 1] - base[:, 1:2])
        near = away - np.hypot(boxes[..., 2], boxes[..., 3]) <= reach
        most = max(int(near.sum(axis=1).max(initial=0)), 1)
        order = np.argsort(~near, axis=1, kind="stable")[:, :most]
        return np.take_along_axis(boxes, order[:, :, None], axis=1)

    def _put(self, lane: int, begin: int, rectangles: FloatArray) -> None:
        end = begin + len(rectangles)
        missing = end - self._rectangles.shape[1]
        if missing > 0:
            empty = np.full((len(self._count), missing, 6), _NOTHING)
            self._rectangles = np.concatenate([self._rectangles, empty], axis=1)
        self._rectangles[lane, begin:end, :4] = rectangles[:, :4]
        self._rectangles[lane, begin:end, 4] = np.cos(rectangles[:, 4])
        self._rectangles[lane, begin:end, 5] = np.sin(rectangles[:, 4])
        self._rectangles[lane, end:] = _NOTHING
        self._count[lane] = end


NEIGHBORS = 2
"""Number of nearest neighbors in the state."""
NEIGHBORHOOD = 0.5
"""Largest distance of a neighbor from the target in [m]."""


class Neighbors(NamedTuple):
    """The neighbors of the targets of n lanes."""

    from_object: FloatArray
    """From the target to the nearest other objects, in the room; 0 where there is none. Shape (n, NEIGHBORS, 3)."""
    distance: FloatArray
    """From the gripper point to the nearest other object in [m], inf without one. Shape (n,)."""
    handle_distance: FloatArray
    """From the gripper point to the nearest handle in [m], inf without one. Shape (n,)."""


def no_neighbors(n: int) -> Neighbors:
    """Return empty neighborhoods of n targets."""
    return Neighbors(np.zeros((n, NEIGHBORS, 3)), np.full(n, np.inf), np.full(n, np.inf))


class Surroundings:
    """Objects and handles of n lanes, so that all are searched at once; missing ones are infinitely far.

    The magic grasp takes the nearest handle within reach, else the nearest object, so a robot that picks must know
    them; its head camera would show them.
    """

    def __init__(self, lanes: int) -> None:
        """Begin without scenes."""
        self._scenes: list[Scene | None] = [None] * lanes
        self._middles = np.full((lanes, NEIGHBORS + 1, 3), np.inf)
        self._objects = np.zeros(lanes, dtype=np.int64)
        self._positions = np.zeros((lanes, 1))
        self._handles = Handles.none(lanes, 1)

    def look(self, numbers: IntArray, lanes: Sequence[Simulator], targets: IntArray, grippers: FloatArray) -> Neighbors:
        """Return the neighbors of targets in n lanes, from their numbers (n,), the lanes and the gripper points (n, 3).

        A target (n,) that a scene does not have has no neighbors but handles.
        """
        for number, lane in zip(numbers.tolist(), lanes, strict=True):
            if self._scenes[number] is not lane.scene:
                self._enter(number, lane.scene)
            self._middles[number, : self._objects[number]] = lane.qpos[lane.scene.middles]
            self._positions[number, : len(lane.scene.links)] = lane.links
        handles = self._handles[numbers].at(self._positions[numbers])
        handle_distance = norm((handles - grippers[:, None]).reshape(-1, 3)).reshape(len(numbers), -1).min(axis=1)
        return Neighbors(*self._around(numbers, targets, grippers), handle_distance)

    def _around(self, numbers: IntArray, targets: IntArray, grippers: FloatArray) -> tuple[FloatArray, FloatArray]:
        middles, rows = self._middles[numbers], np.arange(len(numbers))
        known = (targets >= 0) & (targets < self._objects[numbers])
        target = np.where(known, targets, 0)
        at = np.where(known[:, None], middles[rows, target], 0.0)
        middles[rows, target] = np.inf
        middles[~known] = np.inf
        distance = norm((middles - grippers[:, None]).reshape(-1, 3)).reshape(len(rows), -1).min(axis=1)
        apart = middles - at[:, None]
        away = norm(apart.reshape(-1, 3)).reshape(len(rows), -1)
        nearest = np.argsort(away, axis=1, kind="stable")[:, :NEIGHBORS]
        near = np.take_along_axis(away, nearest, axis=1) <= NEIGHBORHOOD
        return np.where(near[:, :, None], apart[rows[:, None], nearest], 0.0), distance

    def _enter(self, number: int, scene: Scene) -> None:
        """Make room for another scene."""
        objects, links = len(scene.placements), len(scene.links)
        more = objects - self._middles.shape[1]
        if more > 0:
            self._middles = np.pad(self._middles, ((0, 0), (0, more), (0, 0)), constant_values=np.inf)
        more = links - self._positions.shape[1]
        if more > 0:
            self._positions = np.pad(self._positions, ((0, 0), (0, more)))
            self._handles = self._handles.widened(more)
        self._middles[number], self._positions[number] = np.inf, 0.0
        self._handles.put(number, scene.handles)
        self._scenes[number], self._objects[number] = scene, objects
