"""Sensor readings of all lanes after the last step, as arrays."""

from __future__ import annotations

import numpy as np

from perdure.home.sim.arrays import BoolArray, FloatArray, IntArray
from perdure.home.sim.world.neighbors import Neighbors
from perdure.home.sim.world.scene import CONTROL_HZ
from perdure.home.sim.world.simulator import ARM_FROM, ARM_TO, TORSO, Simulator
from perdure.home.sim.world.state import PrivilegedState, SkillGoal, norm, turn, wrap


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
        """Joints of one lane's robot, and its gripper."""
        self.robot[number] = lane.robot[:ARM_TO]
        self.robot_velocity[number] = lane.robot_velocity[:ARM_TO]
        self._point[number], self._axes[number] = lane.gripper, lane.gripper_axes

    def move_grippers(self, chosen: IntArray, calm: BoolArray) -> None:
        """Where the grippers are now that the joints are read; where `calm` they have no past to have a speed."""
        point, axes, base = self._point[chosen], self._axes[chosen], self.robot[chosen, :3]
        cos, sin = np.cos(base[:, 2]), np.sin(base[:, 2])
        x, y = point[:, 0] - base[:, 0], point[:, 1] - base[:, 1]
        position, rotation = point.copy(), axes.copy()
        position[:, 0], position[:, 1] = cos * x + sin * y, cos * y - sin * x
        cos, sin = cos[:, None], sin[:, None]
        rotation[:, 0], rotation[:, 1] = cos * axes[:, 0] + sin * axes[:, 1], cos * axes[:, 1] - sin * axes[:, 0]
        moved = np.where(calm[:, None], 0.0, (point - self.gripper[chosen]) * CONTROL_HZ)
        self.gripper_in_base[chosen], self.rotation[chosen] = position, rotation
        self.gripper[chosen], self.gripper_velocity[chosen] = point, moved

    def take_skill_goal(self, number: int, lane: Simulator, skill_goal: SkillGoal) -> None:
        """What a lane is about from now on."""
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


def up_axis(quaternion: FloatArray) -> FloatArray:
    """Return the z axis of rotations given as (w, x, y, z). Shape (n, 4) -> (n, 3)."""
    w, x, y, z = quaternion.T
    up = np.empty((len(quaternion), 3))
    up[:, 0], up[:, 1], up[:, 2] = 2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)
    return up


_NO_OBJECT = (np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]), np.zeros(3))
