"""The privileged state of every lane after a control step: one record of arrays, the only input of skills."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from perdure.home.sim.apartments import Geodesic
from perdure.home.sim.arrays import BoolArray, FloatArray, IntArray
from perdure.home.sim.world.actions import GRASP_RADIUS


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
    """The skill_goal's object. Shape (n,)."""
    object: FloatArray
    """Its middle in the room. Shape (n, 3)."""
    object_up: FloatArray
    """Its own z axis in the room. Shape (n, 3)."""
    object_velocity: FloatArray
    """Linear, in the room. Shape (n, 3)."""
    goal: FloatArray
    """Its goal position. Shape (n, 3)."""
    link: IntArray
    """The skill_goal's drawer or door, -1 when there is none. Shape (n,)."""
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
    """Whether the robot said in the last step that it has arrived; False when it got a new skill_goal. Shape (n,)."""
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
        return turn(points - self._base_origin, -self.base[:, 2])

    def turned_to_base(self, vectors: FloatArray) -> FloatArray:
        """Return vectors of the room along the axes of the base. Shape (n, 3) -> (n, 3)."""
        return turn(vectors, -self.base[:, 2])

    def turned_to_gripper(self, vectors: FloatArray) -> FloatArray:
        """Return vectors of the room along the axes of the gripper. Shape (n, 3) -> (n, 3)."""
        in_base = self.turned_to_base(vectors)
        # Written out: a matrix product may round differently for one lane than for many.
        axes = self.gripper_rotation
        return in_base[:, :1] * axes[:, 0] + in_base[:, 1:2] * axes[:, 1] + in_base[:, 2:] * axes[:, 2]

    @property
    def _base_origin(self) -> FloatArray:
        return np.concatenate([self.base[:, :2], np.zeros((len(self), 1))], axis=1)


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
