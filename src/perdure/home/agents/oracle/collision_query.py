"""Collision queries: what the robot would touch at another pose, without moving the simulation."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from perdure.home.sim.apartments import Pose
from perdure.home.sim.arrays import FloatArray
from perdure.home.sim.robot import gripper_pose
from perdure.home.sim.robot.data import TORSO_HEIGHT
from perdure.home.sim.world import Simulator
from perdure.home.sim.world.handles import Handles
from perdure.home.sim.world.simulator import ARM_FROM, ARM_TO, TORSO

PUSHED = 0.25
"""Weight of penetration into a loose object, relative to furniture."""
TOLERATED = 0.002
"""Penetration in [m] that does not count as a contact."""


class CollisionQuery:
    """A second `MjData` of a lane's model, with the rest of the world frozen at the time of the query."""

    def __init__(self, simulator: Simulator) -> None:
        """Copy the state of a lane."""
        import mujoco

        self._mujoco = mujoco
        self.simulator = simulator
        simulator.search_all()  # where the query goes there may be what the robot cannot reach from here
        self._data: Any = mujoco.MjData(simulator.model)
        self._data.qpos[:] = simulator.qpos
        self._start: FloatArray = np.array(simulator.qpos)
        self._held = simulator.held

    def handles(self) -> FloatArray:
        """Return the handles of all drawers and doors in the room. Shape (links, 3)."""
        scene = self.simulator.scene
        return Handles.of(scene.apartment).at(self._start[scene.link_qpos])

    def position(self, link: int) -> float:
        """Return how far a drawer or door is open in [m] or [rad]."""
        return float(self._start[self.simulator.scene.link_qpos[link]])

    def in_fridge(self, point: FloatArray) -> bool:
        """Return whether a point of the room is within the fridge's outline."""
        apartment = self.simulator.scene.apartment
        fridge = next((piece for piece in apartment.pieces if piece.kind == "fridge"), None)
        if fridge is None:
            return False
        local = fridge.pose.to_local(np.asarray(point))
        return bool(abs(local[0]) < 0.35 and abs(local[1]) < 0.35)

    def depth(self, base: Pose, arm: ArrayLike, firm: int = -1) -> float:
        """Return the penetration of the robot and the held object at a pose in [m], 0 for free; arm of shape (7,).

        `firm` is the number of an object that must not be pushed aside.
        """
        scene, data = self.simulator.scene, self._data
        data.qpos[:] = self._start
        robot = data.qpos[scene.robot_qpos]
        robot[:3] = base.x, base.y, base.yaw
        robot[TORSO], robot[ARM_FROM:ARM_TO] = TORSO_HEIGHT, arm
        if self._held >= 0:
            position, rotation = gripper_in_room(base, np.asarray(arm, dtype=np.float64))
            address = scene.object_qpos[self._held]
            data.qpos[address : address + 3] = position
            self._mujoco.mju_mat2Quat(data.qpos[address + 3 : address + 7], rotation.ravel())
        self._mujoco.mj_kinematics(self.simulator.model, data)
        self._mujoco.mj_collision(self.simulator.model, data)
        return self._deepest(firm)

    def _deepest(self, firm: int) -> float:
        scene, contact = self.simulator.scene, self._data.contact
        geoms, distance = contact.geom, contact.dist
        if not len(distance):
            return 0.0
        robot = scene.robot_geoms[geoms]
        ours = robot.any(axis=1)
        if self._held >= 0:
            carried = np.isin(geoms, scene.object_geoms[self._held])
            ours = (robot | carried).any(axis=1) & ~(robot | carried).all(axis=1)
        # What can be pushed aside is less of an obstacle than what cannot.
        loose = scene.loose_geoms[geoms].any(axis=1)
        if firm >= 0:
            loose &= ~np.isin(geoms, scene.object_geoms[firm]).any(axis=1)
        deep = np.maximum(-distance - TOLERATED, 0.0) * np.where(loose, PUSHED, 1.0)
        return float(deep[ours].max()) if ours.any() else 0.0

    def path_depth(self, base: Pose, start: ArrayLike, end: ArrayLike, firm: int = -1, points: int = 8) -> float:
        """Return the deepest touch on the straight way between two arm poses, both ends included, in [m]."""
        first, last = np.asarray(start, dtype=np.float64), np.asarray(end, dtype=np.float64)
        return max(self.depth(base, first + share * (last - first), firm) for share in np.linspace(0.0, 1.0, points))


def gripper_in_room(base: Pose, arm: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return where the gripper would be in the room: position (3,) and rotation (3, 3)."""
    position, rotation = gripper_pose(TORSO_HEIGHT, arm)
    cos, sin = np.cos(base.yaw), np.sin(base.yaw)
    about_z = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    return base.to_room(position), about_z @ rotation
