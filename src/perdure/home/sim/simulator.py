"""One simulated robot in a scene: its actions, the magic grasp, release, forces."""

from __future__ import annotations

import math
from collections.abc import Mapping
from copy import copy
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from perdure.home.sim.arrays import FloatArray
from perdure.home.sim.geoms import OBJECT_BIT
from perdure.home.sim.objects import Placement
from perdure.home.sim.pieces import Pose
from perdure.home.sim.robot import ROBOT
from perdure.home.sim.scene import CONTROL_HZ, HABITAT_DRAG, NEARBY_LASTS, Scene

STOP_LEVEL = 0.9
"""Above it a robot says that it has arrived, and the base stops; below 0 it denies it, 0 leaves it to the map (our
choice; M3 has a discrete action for it)."""

BASE_SPEED = 1.5
"""Forward speed in [m/s] and turning speed in [rad/s] of an action of 1 in manipulation skills (M3)."""
NAVIGATION_SPEED = 3.0
"""The same in navigation (M3, whose actions are 20 discrete ones; ours are continuous)."""
ARM_STEP = 0.025
"""What an action of 1 adds to a joint's servo target in one control step, in [rad] (M3)."""
GRASP = 1.0
RELEASE = -1.0
LEAVE = 0.0
"""Gripper: above 0 grasps, below 0 releases (M3's signs; the thesis has them the other way round), 0 does nothing."""
GRASP_RADIUS = 0.15
"""How near a handle or an object's middle must be to the gripper point to be grasped, in [m] (M3, habitat-lab)."""


class Simulator:
    """One simulation with one robot; `VectorSimulator` runs many of them."""

    def __init__(self, scene: Scene) -> None:
        """A simulation at the scene's start, the robot at the room's origin: place it before stepping."""
        import mujoco

        self._mujoco = mujoco
        self.scene = scene
        self.model: Any = copy(scene.model)
        self.data: Any = mujoco.MjData(self.model)
        self.qpos: FloatArray = self.data.qpos
        self.qvel: FloatArray = self.data.qvel
        self.ctrl: FloatArray = self.data.ctrl
        self.robot: FloatArray = self.qpos[scene.robot_qpos]
        self.robot_velocity: FloatArray = self.qvel[scene.robot_qvel]
        gripper = int(self.model.site(ROBOT.gripper_site).id)
        self.gripper: FloatArray = self.data.site_xpos[gripper]
        """The gripper point in the room, as of the last step's end. Shape (3,)."""
        self.gripper_axes: FloatArray = self.data.site_xmat[gripper].reshape(3, 3)
        """Its axes in the room, one per column. Shape (3, 3)."""
        self.held = -1
        self.held_link = -1
        self._passing: set[int] = set()
        """Objects that have been held: they pass through the robot until the next reset."""
        first = int(mujoco.mjtWarning.mjWARN_BADQPOS)
        last = int(mujoco.mjtWarning.mjWARN_BADQACC)
        self._bad_states: NDArray[np.int32] = self.data.warning.number[first : last + 1]
        self._substeps = scene.options.physics_hz // CONTROL_HZ
        self._counted: NDArray[np.bool_] = scene.arm_geoms.copy()
        self._searched_from: tuple[float, float] | None = None
        self.set_rolling(scene.options.rolling)

    def reset(
        self,
        base: Pose,
        arm: ArrayLike = ROBOT.rest_arm,
        opened: Mapping[str, float] | None = None,
        moved: Mapping[int, Placement] | None = None,
    ) -> None:
        """Reset to the start of an episode: base pose, joint angles of the arm, drawers and doors by link name.

        Links that are not named take the scene's own positions; so do objects that `moved` does not place by number.
        """
        # Nothing is held, and no object passes through the robot.
        self._mujoco.mj_resetData(self.model, self.data)
        self.search_all()
        self.release()
        for number in self._passing:
            self._collide(number, True)
        self._passing.clear()

        # Drawers, doors and objects.
        scene = self.scene
        wanted = {**scene.opened, **(opened or {})}
        for link, address in zip(scene.links, scene.link_qpos, strict=True):
            self.qpos[address] = wanted.get(link, 0.0)
        for number, placement in (moved or {}).items():
            pose, _ = self.object(number)
            pose[:3] = placement.position
            pose[3:] = placement.quaternion

        # The robot; its servos hold it where it is.
        self.robot[:] = 0.0
        self.robot[:3] = base.x, base.y, base.yaw
        self.robot[ROBOT.torso_column] = ROBOT.torso_height
        self.robot[ROBOT.arm_columns] = arm
        self.robot[ROBOT.finger_columns] = ROBOT.finger_opening
        self.ctrl[:] = self.robot
        self.ctrl[:3] = 0.0
        self._mujoco.mj_forward(self.model, self.data)

    def set_rolling(self, lever: float) -> None:
        """Set the rolling resistance of all objects, see `WorldOptions.rolling`."""
        model = self.model
        scene = self.scene
        round_ones = scene.model.geom_condim == 6
        if lever > 0.0:
            drag = 0.0
            model.geom_condim[round_ones] = 6
        else:
            drag = HABITAT_DRAG
            model.geom_condim[round_ones] = 3
        model.geom_friction[round_ones, 2] = lever
        for body, dof in zip(scene.object_bodies, scene.object_qvel, strict=True):
            model.dof_damping[dof : dof + 3] = drag * model.body_mass[body]
            model.dof_damping[dof + 3 : dof + 6] = drag * model.body_inertia[body]

    def drive(self, forward: float, turn: float) -> None:
        """Base speeds for the next control step, in [m/s] and [rad/s]."""
        self.ctrl[:3] = forward, 0.0, turn

    def step(self) -> None:
        """One control step of physics; lets other threads run meanwhile."""
        self._exclude_far_bodies()
        self._mujoco.mj_step(self.model, self.data, self._substeps)
        self._mujoco.mj_kinematics(self.model, self.data)  # mj_step leaves poses as they were before its last step

    @property
    def links(self) -> FloatArray:
        """How far each drawer and door is open, in the order of `Scene.links`. Shape (links,)."""
        return self.qpos[self.scene.link_qpos]

    @property
    def handles(self) -> FloatArray:
        """Handles of all drawers and doors in the room. Shape (links, 3)."""
        return self.scene.handles.at(self.links)

    @property
    def middles(self) -> FloatArray:
        """Middles of all objects in the room. Shape (objects, 3)."""
        return np.asarray(self.qpos[self.scene.object_qpos[:, None] + np.arange(3)])

    def forward(self) -> None:
        """Renew what MuJoCo derives from positions, without a step."""
        self._mujoco.mj_forward(self.model, self.data)

    def object(self, number: int) -> tuple[FloatArray, FloatArray]:
        """Return pose (position, quaternion) and linear velocity of an object, views. Shapes (7,), (3,)."""
        address = self.scene.object_qpos[number]
        speed = self.scene.object_qvel[number]
        return self.qpos[address : address + 7], self.qvel[speed : speed + 3]

    def objects(self, count: int) -> tuple[FloatArray, FloatArray]:
        """Return poses and linear velocities of the first objects. Shapes (count, 7), (count, 3)."""
        qpos = self.scene.object_qpos[:count, None]
        qvel = self.scene.object_qvel[:count, None]
        return self.qpos[qpos + np.arange(7)], self.qvel[qvel + np.arange(3)]

    def grasp(self, gripper: FloatArray, rotation: FloatArray, handles: FloatArray) -> None:
        """The magic grasp: the nearest handle within reach, else the nearest object, turned to the gripper's axes.

        Does nothing with a full hand or with nothing within 0.15 m. Gripper point (3,), its axes as columns (3, 3) and
        the handles of all links (links, 3) are in the room.
        """
        if self.held >= 0 or self.held_link >= 0:
            return
        link = _within_reach(handles, gripper)
        if link >= 0:
            self.hold_link(link, rotation.T @ (handles[link] - gripper), handles[link])
            return
        number = _within_reach(self.middles, gripper)
        if number >= 0:
            self.hold_object(number, gripper, rotation)

    def hold_link(self, link: int, in_gripper: FloatArray, in_room: FloatArray) -> None:
        """Attach the handle of a link to the hand at its present distance.

        M3 draws the handle to the gripper point; there hand and handle would push against each other. The handle's
        position is given from the gripper point along the gripper's axes, and in the room. Shapes (3,).
        """
        self.held_link = link
        equality = self.scene.hold(self.scene.links[link])
        body = self.data.body(self.scene.links[link])
        self._mujoco.mj_kinematics(self.model, self.data)
        self.model.eq_data[equality, :3] = in_gripper + self.model.site(ROBOT.gripper_site).pos
        self.model.eq_data[equality, 3:6] = body.xmat.reshape(3, 3).T @ (in_room - body.xpos)
        self.data.eq_active[equality] = 1

    def hold_object(self, number: int, gripper: FloatArray, rotation: FloatArray) -> None:
        """Put an object into the gripper, its axes along the gripper's, and ties it there.

        From now on it passes through the robot, also after its release (M3).
        """
        pose, _ = self.object(number)
        speed = self.scene.object_qvel[number]
        pose[:3] = gripper
        self._mujoco.mju_mat2Quat(pose[3:], rotation.ravel())
        self.qvel[speed : speed + 6] = 0.0
        self.data.eq_active[self.scene.hold(f"object_{number}")] = 1
        self._collide(number, False)
        self._passing.add(number)
        self.held = number
        self._counted[self.scene.object_geoms[number]] = True

    def release(self) -> None:
        """Release whatever is held; an object keeps its velocity."""
        if self.held_link >= 0:
            self.data.eq_active[self.scene.hold(self.scene.links[self.held_link])] = 0
            self.held_link = -1
        if self.held >= 0:
            self.data.eq_active[self.scene.hold(f"object_{self.held}")] = 0
            self._counted[self.scene.object_geoms[self.held]] = False
            self.held = -1

    def diverged(self) -> bool:
        """Return whether MuJoCo warned of a bad state, or a position is not a finite number."""
        return any(self._bad_states.tolist()) or not math.isfinite(self.qpos @ self.qpos)

    def robot_force(self) -> float:
        """Return largest normal force at the arm, its hand or what it holds, in the last physics step in [N].

        The base does not count: in M3 it moves on its navigation mesh and can touch nothing, here furniture stops it.
        """
        if not self.data.ncon:
            return 0.0
        contact = self.data.contact
        rows = contact.efc_address
        rows = rows[self._counted[contact.geom].any(axis=1) & (rows >= 0)]
        if not len(rows):
            return 0.0
        return float(self.data.efc_force[rows].max())

    def _exclude_far_bodies(self) -> None:
        """Exclude bodies that nothing can touch from the contact search, see `nearby`."""
        expected = 1 + (self.held >= 0) + (self.held_link >= 0)
        if self.data.ntree_awake > expected:
            if self._searched_from is not None:
                self.search_all()
            return
        x, y = self.robot[:2].tolist()
        if self._searched_from is not None:
            dx = x - self._searched_from[0]
            dy = y - self._searched_from[1]
            if dx * dx + dy * dy < NEARBY_LASTS * NEARBY_LASTS:
                return
        nearby = self.scene.nearby
        near = nearby.around(np.array([x, y]), self.middles[:, :2])
        self.model.body_contype[:] = np.where(near, nearby.contype, 0)
        self.model.body_conaffinity[:] = np.where(near, nearby.conaffinity, 0)
        self._searched_from = (x, y)

    def search_all(self) -> None:
        """Search for contacts everywhere again until the robot has moved, for queries about other places."""
        nearby = self.scene.nearby
        self.model.body_contype[:] = nearby.contype
        self.model.body_conaffinity[:] = nearby.conaffinity
        self._searched_from = None

    def _collide(self, number: int, robot: bool) -> None:
        """Set whether an object collides with the robot; objects always collide with each other."""
        self.model.geom_conaffinity[self.scene.object_geoms[number]] = OBJECT_BIT | int(robot)


def _within_reach(points: FloatArray, gripper: FloatArray) -> int:
    """Return the number of the nearest point (n, 3) if the magic grasp reaches it, else -1."""
    distance = np.sqrt(((points - gripper) ** 2).sum(axis=1))
    if (distance <= GRASP_RADIUS).any():
        return int(distance.argmin())
    return -1
