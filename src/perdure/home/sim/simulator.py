"""One simulated robot in a scene: its actions, its state, forces. `hand` has the magic grasp and the release."""

from __future__ import annotations

import math
from collections.abc import Mapping
from copy import copy
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from perdure.home.sim.arrays import BoolArray, FloatArray
from perdure.home.sim.hand import Hand
from perdure.home.sim.objects import Placement
from perdure.home.sim.pieces import Pose
from perdure.home.sim.robot import ROBOT
from perdure.home.sim.scene import CONTROL_HZ, HABITAT_DRAG, NEARBY_LASTS, Scene

STOP_LEVEL = 0.9
"""Above it a robot says that it has arrived, and the base stops; below 0 it denies it, 0 leaves it to the map (our
choice; M3 has a discrete action for it)."""

BASE_SPEED = 1.5
"""Forward speed in [m/s] and turning speed in [rad/s] of an action of 1 in manipulation skills (M3), where the base is
so fast, see `WorldOptions.base_speed`."""
NAVIGATION_SPEED = 3.0
"""The same in navigation (M3, whose actions are 20 discrete ones; ours are continuous)."""
ARM_STEP = 0.025
"""What an action of 1 adds to a joint's servo target in one control step, in [rad] (M3)."""
GRASP = 1.0
RELEASE = -1.0
LEAVE = 0.0
"""Gripper: above 0 grasps, below 0 releases (M3's signs; the thesis has them the other way round), 0 does nothing."""


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
        self.hand = Hand(scene, self.model, self.data)
        first = int(mujoco.mjtWarning.mjWARN_BADQPOS)
        last = int(mujoco.mjtWarning.mjWARN_BADQACC)
        self._bad_states: NDArray[np.int32] = self.data.warning.number[first : last + 1]
        self._substeps = scene.options.physics_hz // CONTROL_HZ
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
        self._mujoco.mj_resetData(self.model, self.data)
        self.search_all()
        self.hand.reset()

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
        self.hand.advance()
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

    @property
    def held(self) -> int:
        """Number of the held object, -1 for none."""
        return self.hand.held

    @property
    def held_link(self) -> int:
        """Number of the link whose handle is held, -1 for none."""
        return self.hand.held_link

    def grasp(self) -> None:
        """The magic grasp, see `Hand.grasp`."""
        self.hand.grasp(self.gripper, self.gripper_axes, self.handles, self.middles)

    def release(self) -> None:
        """Release whatever is held; an object keeps its velocity."""
        self.hand.release()

    def base_speed(self, speed: float) -> float:
        """Return the speed of a base action of 1 in [m/s] and [rad/s]: a skill's, but no more than the base has."""
        return min(speed, self.scene.options.base_speed)

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
        rows = rows[self.hand.counted[contact.geom].any(axis=1) & (rows >= 0)]
        if not len(rows):
            return 0.0
        return float(self.data.efc_force[rows].max())

    def touched(self, count: int) -> BoolArray:
        """Return which of the first objects the arm or its hand touches; never what it holds. Shape (count,)."""
        geoms = self.data.contact.geom
        touched = np.zeros(len(self.scene.placements) + 1, dtype=bool)
        if len(geoms):
            arm = self.scene.arm_geoms[geoms]
            numbers = self.scene.geom_object[geoms]
            touched[numbers[arm[:, ::-1]]] = True  # the other geom of a contact; -1 is the last entry
        return touched[:count]

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
