"""The robot's hand: the magic grasp, what it holds, and when what it has released collides with the robot again.

A held object passes through the robot. Two rules are known (`WorldOptions.grasp`):

- "kept": the object keeps the attitude in which it was grasped. The distance to the hand closes until they touch. A
  released object collides with the robot again as soon as nothing of the robot is inside it.
- "snapped": the object jumps to the gripper point and turns to the gripper's axes. Once it was held it passes through
  the robot until the next reset (M3).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from perdure.home.sim.arrays import FloatArray, IntArray
from perdure.home.sim.geoms import OBJECT_BIT, ROBOT_BIT
from perdure.home.sim.robot import ROBOT
from perdure.home.sim.scene import CONTROL_HZ, Scene

GRASP_RADIUS = 0.15
"""How near a handle or an object's middle must be to the gripper point to be grasped, in [m] (M3, habitat-lab)."""
CLOSING_STEPS = 10
"""Control steps in which a grasped object comes to the hand, a third of a second (our choice)."""
SOLID_AGAIN = CONTROL_HZ // 2
"""Control steps after a release at which an object collides with the robot again at the latest."""
GAP = 0.001
"""Distance in [m] that is left between the hand and what it holds."""
TRACES = 25
"""Largest number of steps in the search for the contact of hand and object."""


class Hand:
    """The hand of one simulation."""

    def __init__(self, scene: Scene, model: Any, data: Any) -> None:
        """Begin with an empty hand; `model` is the simulation's own copy, `data` its `mujoco.MjData`."""
        import mujoco

        self._mujoco = mujoco
        self._scene = scene
        self._model = model
        self._data = data
        self._site = int(model.site(ROBOT.gripper_site).id)
        self._snaps = scene.options.grasp == "snapped"
        self.held = -1
        """Number of the held object, -1 for none."""
        self.held_link = -1
        """Number of the link whose handle is held, -1 for none."""
        self.offset: FloatArray = np.zeros(3)
        """From the gripper point to the middle of the held object, along the gripper's axes, in [m]. Shape (3,)."""
        self.turn: FloatArray = np.eye(3)
        """The held object's axes along the gripper's, one per column. Shape (3, 3)."""
        self._step: FloatArray = np.zeros(3)
        """What a control step adds to `offset` while the object comes to the hand."""
        self._closing = 0
        """Control steps until it has come."""
        self._passing: dict[int, int] = {}
        """Objects that pass through the robot: control steps since they were released, 0 while held."""
        self.counted = scene.arm_geoms.copy()
        """Geoms whose contact forces count: the arm's, the hand's and those of what it holds. Shape (geoms,)."""
        solid = scene.robot_geoms & ((scene.model.geom_contype & ROBOT_BIT) > 0)
        self._robot: IntArray = np.flatnonzero(solid)

    def reset(self) -> None:
        """Empty the hand; every object collides with the robot."""
        self.release()
        for number in self._passing:
            self._collide(number, True)
        self._passing.clear()

    def grasp(self, gripper: FloatArray, axes: FloatArray, handles: FloatArray, middles: FloatArray) -> None:
        """The magic grasp: take the nearest handle within reach, else the nearest object.

        Does nothing with a full hand or with nothing within 0.15 m. Gripper point (3,), its axes as columns (3, 3), the
        handles of all links (links, 3) and the middles of all objects (objects, 3) are in the room.
        """
        if self.held >= 0 or self.held_link >= 0:
            return
        link = _within_reach(handles, gripper)
        if link >= 0:
            self.hold_link(link, axes.T @ (handles[link] - gripper), handles[link])
            return
        number = _within_reach(middles, gripper)
        if number >= 0:
            self.hold_object(number)

    def hold_link(self, link: int, in_gripper: FloatArray, in_room: FloatArray) -> None:
        """Attach the handle of a link to the hand at its present distance.

        M3 draws the handle to the gripper point; there hand and handle would push against each other. The handle's
        position is given from the gripper point along the gripper's axes, and in the room. Shapes (3,).
        """
        self.held_link = link
        equality = self._scene.hold(self._scene.links[link])
        body = self._data.body(self._scene.links[link])
        self._mujoco.mj_kinematics(self._model, self._data)
        self._model.eq_data[equality, :3] = in_gripper + self._model.site_pos[self._site]
        self._model.eq_data[equality, 3:6] = body.xmat.reshape(3, 3).T @ (in_room - body.xpos)
        self._data.eq_active[equality] = 1

    def hold_object(self, number: int, at_once: bool = False) -> None:
        """Tie an object to the hand as it is, and draw it to the hand until they touch, without turning it.

        The distance closes over `CLOSING_STEPS`, or at once. With the rule "snapped" see the module.
        """
        self.held = number
        self._collide(number, False)
        self._passing[number] = 0
        self.counted[self._scene.object_geoms[number]] = True
        gripper = self._data.site_xpos[self._site]
        axes = self._data.site_xmat[self._site].reshape(3, 3)
        address = self._scene.object_qpos[number]
        pose = self._data.qpos[address : address + 7]
        self._closing = 0
        if self._snaps:
            self.offset = np.zeros(3)
            self.turn = np.eye(3)
            self._move(number, gripper, axes)
        else:
            rotation = np.empty(9)
            self._mujoco.mju_quat2Mat(rotation, pose[3:])
            self.offset = axes.T @ (pose[:3] - gripper)
            self.turn = axes.T @ rotation.reshape(3, 3)
            way = -self._way_to_contact(number, gripper - pose[:3]) * self.offset
            if at_once:
                self.offset = self.offset + way
                self._move(number, gripper + axes @ self.offset, axes @ self.turn)
            else:
                self._step = way / CLOSING_STEPS
                self._closing = CLOSING_STEPS
        self._tie()

    def hold_from_start(self, number: int, placed: bool) -> None:
        """Hold an object when an episode begins: as it lies if it was placed, else with its axes along the gripper's.

        Where hand and object touch decides how far it is from the gripper point.
        """
        if not placed:
            axes = self._data.site_xmat[self._site].reshape(3, 3)
            self._move(number, self._data.site_xpos[self._site] + GRASP_RADIUS * axes[:, 0], axes)
            self._mujoco.mj_kinematics(self._model, self._data)
        self.hold_object(number, at_once=True)
        self._mujoco.mj_forward(self._model, self._data)

    def release(self) -> None:
        """Release whatever is held; an object keeps its velocity."""
        if self.held_link >= 0:
            self._data.eq_active[self._scene.hold(self._scene.links[self.held_link])] = 0
            self.held_link = -1
        if self.held >= 0:
            self._data.eq_active[self._scene.hold(f"object_{self.held}")] = 0
            self.counted[self._scene.object_geoms[self.held]] = False
            self.held = -1

    def advance(self) -> None:
        """Go on by one control step, before the physics: close the distance, let released objects collide again."""
        if self._closing and self.held >= 0:
            self._closing -= 1
            self.offset = self.offset + self._step
            self._tie()
        if self._snaps:
            return
        for number, steps in list(self._passing.items()):
            if number == self.held:
                continue
            if steps >= SOLID_AGAIN or self.clearance(number) >= 0.0:
                self._collide(number, True)
                del self._passing[number]
            else:
                self._passing[number] = steps + 1

    def clearance(self, number: int, farthest: float = GAP) -> float:
        """Return the distance in [m] between the robot and an object, negative inside it, at most `farthest`.

        Poses are those of the last kinematics.
        """
        data = self._data
        radius = self._model.geom_rbound
        nearest = farthest
        for geom in self._scene.object_geoms[number].tolist():
            apart = np.linalg.norm(data.geom_xpos[self._robot] - data.geom_xpos[geom], axis=1)
            near = apart - radius[self._robot] - radius[geom] < nearest
            for other in self._robot[near].tolist():
                found = self._mujoco.mj_geomDistance(self._model, data, geom, other, nearest, None)
                nearest = min(nearest, float(found))
        return nearest

    def _way_to_contact(self, number: int, way: FloatArray) -> float:
        """Return the share of a way in the room, shape (3,), that an object can go until it touches the robot.

        It goes as far as it is away from the robot, again and again (sphere tracing), so it never goes into it.
        """
        geoms = self._scene.object_geoms[number]
        positions = self._data.geom_xpos[geoms].copy()
        length = float(np.linalg.norm(way))
        gone = 0.0
        for _ in range(TRACES):
            if gone >= length:
                break
            self._data.geom_xpos[geoms] = positions + way * (gone / length)
            room = self.clearance(number, length - gone + GAP) - GAP
            if room < 0.1 * GAP:
                break
            gone = min(gone + room, length)
        self._data.geom_xpos[geoms] = positions
        return gone / length if length > 0.0 else 1.0

    def _move(self, number: int, position: FloatArray, rotation: FloatArray) -> None:
        """Put an object somewhere, at rest."""
        address = self._scene.object_qpos[number]
        speed = self._scene.object_qvel[number]
        self._data.qpos[address : address + 3] = position
        self._mujoco.mju_mat2Quat(self._data.qpos[address + 3 : address + 7], np.ascontiguousarray(rotation).ravel())
        self._data.qvel[speed : speed + 6] = 0.0

    def _tie(self) -> None:
        """Hold the object at `offset` and `turn`."""
        equality = self._scene.hold(f"object_{self.held}")
        self._model.eq_data[equality, 3:6] = self._model.site_pos[self._site] + self.offset
        self._mujoco.mju_mat2Quat(self._model.eq_data[equality, 6:10], np.ascontiguousarray(self.turn).ravel())
        self._data.eq_active[equality] = 1

    def _collide(self, number: int, robot: bool) -> None:
        """Set whether an object collides with the robot; objects always collide with each other."""
        self._model.geom_conaffinity[self._scene.object_geoms[number]] = OBJECT_BIT | int(robot)


def _within_reach(points: FloatArray, gripper: FloatArray) -> int:
    """Return the number of the nearest point (n, 3) if the magic grasp reaches it, else -1."""
    distance = np.sqrt(((points - gripper) ** 2).sum(axis=1))
    if (distance <= GRASP_RADIUS).any():
        return int(distance.argmin())
    return -1
