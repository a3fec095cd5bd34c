"""Many worlds, stepped together in a pool of threads: the one stepper of training, oracle and execution."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from perdure.home.errors import HomeError
from perdure.home.layouts import Pose
from perdure.home.robot import gripper_pose
from perdure.home.robot.data import ARM_HIGH, ARM_LOW, REST_ARM
from perdure.home.world.actions import ACTION_SIZE, ARM, ARM_STEP, BASE_SPEED, FORWARD, GRIP, TURN
from perdure.home.world.handles import Handles
from perdure.home.world.lane import ARM_FROM, ARM_TO, TORSO, Jaws, Lane
from perdure.home.world.laser import NO_SCAN, scan
from perdure.home.world.scene import CONTROL_HZ, Scene
from perdure.home.world.sensors import Errand, Sensors, norm, turn, wrap

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]


class World:
    """n lanes, each with a scene, a robot and an errand.

    A lane's course depends on its own scene, start and actions only, not on how many lanes there are or on which
    thread steps it.
    """

    def __init__(self, lanes: int, threads: int | None = None, jaws: Jaws = "never") -> None:
        """Makes empty lanes; `reset` fills them.

        Args:
            lanes: How many.
            threads: How many threads step them; the cores this process may use when None.
            jaws: Whether an object that was held meets the robot again: "never" (M3) or "apart" (habitat-lab).
        """
        if lanes < 1:
            raise HomeError(f"a world needs at least one lane, not {lanes}")
        self.num_lanes = lanes
        self._jaws: Jaws = jaws
        self._threads = min(lanes, threads or len(os.sched_getaffinity(0)))
        self._pool = ThreadPoolExecutor(self._threads) if self._threads > 1 else None
        self._lanes: list[Lane | None] = [None] * lanes
        self._handles: list[Handles | None] = [None] * lanes
        self._starts: list[tuple[Pose, FloatArray, Mapping[str, float], int]] = [_NOWHERE] * lanes
        self._errand = [Errand()] * lanes
        self._arm_target = np.tile(REST_ARM, (lanes, 1))
        self._robot = np.zeros((lanes, ARM_TO))
        self._robot_velocity = np.zeros((lanes, ARM_TO))
        self._gripper = np.zeros((lanes, 3))
        self._gripper_velocity = np.zeros((lanes, 3))
        self._gripper_in_base = np.zeros((lanes, 3))
        self._rotation = np.zeros((lanes, 3, 3))
        self._force = np.zeros(lanes)
        self._diverged = np.zeros(lanes, dtype=bool)

    def reset(
        self,
        lane: int,
        scene: Scene,
        base: Pose,
        arm: ArrayLike = REST_ARM,
        opened: Mapping[str, float] | None = None,
        held: int = -1,
        errand: Errand | None = None,
    ) -> None:
        """Starts a lane's episode.

        Args:
            lane: Which lane.
            scene: What it is made of; a lane that already runs this scene does not copy the model again.
            base: Where the robot stands.
            arm: Its arm's joint angles. Shape (7,).
            opened: Joint positions of drawers and doors by link name in place of the scene's own.
            held: Number of the object in the gripper, -1 for none.
            errand: What the lane is about.
        """
        old = self._lanes[lane]
        if old is None or old.scene is not scene:
            self._lanes[lane] = Lane(scene, self._jaws)
            self._handles[lane] = Handles.of(scene.apartment)
        self._starts[lane] = (base, np.array(arm, dtype=np.float64), dict(opened or {}), held)
        self._errand[lane] = errand or Errand()
        self._begin(lane)

    def assign(self, lane: int, errand: Errand) -> None:
        """Gives a lane another errand."""
        self._errand[lane] = errand

    def errand(self, lane: int) -> Errand:
        """What a lane is about."""
        return self._errand[lane]

    def lane(self, number: int) -> Lane:
        """The lane itself, for whoever must look deeper; HomeError before its first reset."""
        lane = self._lanes[number]
        if lane is None:
            raise HomeError(f"lane {number} was not reset yet")
        return lane

    def step(
        self,
        actions: FloatArray,
        lanes: IntArray | None = None,
        base_speed: FloatArray | float = BASE_SPEED,
        arm_step: FloatArray | float = ARM_STEP,
    ) -> None:
        """One control step: gripper, arm and base are told, then physics runs (M3's order).

        Args:
            actions: From -1 to 1, see `actions`; values outside are clipped. Shape (m, 10).
            lanes: Which lanes to step, all when None. Shape (m,).
            base_speed: Speed of a base action of 1 in [m/s] and [rad/s]. Shape (m,).
            arm_step: What an arm action of 1 adds to a servo's target in [rad]. Shape (m,).

        Raises:
            HomeError: If a shape does not fit or an action is not a finite number.
        """
        chosen = np.arange(self.num_lanes) if lanes is None else lanes
        clipped = self._checked(actions, chosen)
        self._command(chosen, clipped, np.broadcast_to(base_speed, len(chosen)), np.broadcast_to(arm_step, len(chosen)))
        if self._pool is None or len(chosen) == 1:
            self._step_some(chosen)
        else:
            parts = [chosen[k :: self._threads] for k in range(self._threads)]
            list(self._pool.map(self._step_some, parts))
        self._read(chosen)

    def sense(self, lanes: IntArray | None = None, laser: bool = False) -> Sensors:
        """What is known of some lanes (all when None) now; with the ranges of the laser where they are asked for."""
        chosen = np.arange(self.num_lanes) if lanes is None else lanes
        numbers = [int(k) for k in chosen]
        errands = [self._errand[k] for k in numbers]
        robot, velocity = self._robot[chosen], self._robot_velocity[chosen]
        bodies = [self._object(k, e.target) for k, e in zip(numbers, errands, strict=True)]
        links = [self._link(k, e.link) for k, e in zip(numbers, errands, strict=True)]
        lanes_ = [self.lane(k) for k in numbers]
        base = robot[:, :3].copy()
        aims = np.array([e.aim for e in errands], dtype=np.float64)
        moving = np.concatenate([velocity[:, :2], np.zeros((len(chosen), 1))], axis=1)
        object_pose = np.array([body[0] for body in bodies])
        result = Sensors(
            base=base,
            base_velocity=np.concatenate([turn(moving, -base[:, 2])[:, :2], velocity[:, 2:3]], axis=1),
            torso=robot[:, TORSO].copy(),
            arm=robot[:, ARM_FROM:ARM_TO].copy(),
            arm_velocity=velocity[:, ARM_FROM:ARM_TO].copy(),
            arm_target=self._arm_target[chosen],
            gripper_in_base=self._gripper_in_base[chosen],
            gripper_rotation=self._rotation[chosen],
            gripper=self._gripper[chosen],
            gripper_velocity=self._gripper_velocity[chosen],
            held=np.array([each.held for each in lanes_]),
            held_link=np.array([each.held_link for each in lanes_]),
            hold_error=np.zeros(len(chosen)),
            target=np.array([e.target for e in errands]),
            object=object_pose[:, :3],
            object_up=_up_axis(object_pose[:, 3:]),
            object_velocity=np.array([body[1] for body in bodies]),
            goal=np.array([e.goal for e in errands], dtype=np.float64),
            link=np.array([e.link for e in errands]),
            handle=np.array([link[0] for link in links]),
            link_position=np.array([link[1] for link in links]),
            link_velocity=np.array([link[2] for link in links]),
            aim=aims,
            way=np.array([self._way(k, e) for k, e in zip(numbers, errands, strict=True)]),
            facing_error=wrap(np.arctan2(aims[:, 1] - base[:, 1], aims[:, 0] - base[:, 0]) - base[:, 2]),
            laser=np.array([scan(self.lane(k)) if laser else NO_SCAN for k in numbers]),
            contact_force=self._force[chosen],
            diverged=self._diverged[chosen],
        )
        return replace(result, hold_error=self._hold_error(numbers, result))

    def objects(self, lane: int, count: int) -> tuple[FloatArray, FloatArray]:
        """Poses (position, quaternion) and linear velocities of a lane's first objects. Shapes (count, 7), (count, 3)."""
        found = [self._object(lane, number) for number in range(count)]
        return np.array([each[0] for each in found]), np.array([each[1] for each in found])

    def close(self) -> None:
        """Ends the threads."""
        if self._pool is not None:
            self._pool.shutdown()
            self._pool = None

    def _begin(self, number: int) -> None:
        base, arm, opened, held = self._starts[number]
        lane = self.lane(number)
        lane.reset(base, arm, opened)
        self._arm_target[number] = arm
        self._force[number] = 0.0
        self._diverged[number] = False
        self._read(np.array([number]), first=True)
        if held >= 0:
            lane.hold_object(held, self._gripper[number], self._room_rotation(number))
            lane._mujoco.mj_forward(lane.model, lane.data)

    def _checked(self, actions: FloatArray, chosen: IntArray) -> FloatArray:
        actions = np.asarray(actions, dtype=np.float64)
        if actions.shape != (len(chosen), ACTION_SIZE):
            raise HomeError(f"actions have shape {actions.shape}; it must be {(len(chosen), ACTION_SIZE)}")
        if not np.isfinite(actions).all():
            raise HomeError(
                f"actions must be finite; those of lanes {chosen[~np.isfinite(actions).all(axis=1)]} are not"
            )
        return np.clip(actions, -1.0, 1.0)

    def _command(self, chosen: IntArray, actions: FloatArray, speed: FloatArray, arm_step: FloatArray) -> None:
        target = np.clip(self._arm_target[chosen] + arm_step[:, None] * actions[:, ARM], ARM_LOW, ARM_HIGH)
        self._arm_target[chosen] = target
        grip = actions[:, GRIP]
        forward, turning = actions[:, FORWARD] * speed, actions[:, TURN] * speed
        for row, number in enumerate(chosen):
            lane = self.lane(number)
            if grip[row] > 0.0:
                lane.grasp(self._gripper[number], self._room_rotation(number), self._handle_points(number))
            elif grip[row] < 0.0:
                lane.release()
            lane.ctrl[ARM_FROM:ARM_TO] = target[row]
            lane.drive(forward[row], turning[row])

    def _step_some(self, chosen: IntArray) -> None:
        for number in chosen:
            lane = self.lane(number)
            lane.step()
            self._force[number] = lane.robot_force()

    def _read(self, chosen: IntArray, first: bool = False) -> None:
        self._diverged[chosen] = False
        for number in chosen:
            lane = self.lane(number)
            if not first and lane.blew_up():
                self._begin(number)
                self._diverged[number] = True
            self._robot[number] = lane.robot[:ARM_TO]
            self._robot_velocity[number] = lane.robot_velocity[:ARM_TO]
        robot = self._robot[chosen]
        position, rotation = gripper_pose(robot[:, TORSO], robot[:, ARM_FROM:ARM_TO])
        gripper = turn(position, robot[:, 2])
        gripper[:, :2] += robot[:, :2]
        calm = self._diverged[chosen] | first
        moved = np.where(calm[:, None], 0.0, (gripper - self._gripper[chosen]) * CONTROL_HZ)
        self._gripper_in_base[chosen], self._rotation[chosen] = position, rotation
        self._gripper[chosen], self._gripper_velocity[chosen] = gripper, moved
        for number in chosen:
            self.lane(number).part(self._gripper[number])

    def _room_rotation(self, number: int) -> FloatArray:
        yaw = self._robot[number, 2]
        cos, sin = np.cos(yaw), np.sin(yaw)
        about_z = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
        rotation: FloatArray = about_z @ self._rotation[number]
        return rotation

    def _handle_points(self, number: int) -> FloatArray:
        lane, handles = self.lane(number), self._handles[number]
        assert handles is not None
        return handles.at(lane.qpos[lane.scene.link_qpos])

    def _object(self, number: int, target: int) -> tuple[FloatArray, FloatArray]:
        """Pose (7,) and linear velocity (3,) of an object; zeros where the scene has no such object."""
        lane = self.lane(number)
        if not 0 <= target < len(lane.scene.placements):
            return np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]), np.zeros(3)
        address, speed = lane.scene.object_qpos[target], lane.scene.object_qvel[target]
        return lane.qpos[address : address + 7].copy(), lane.qvel[speed : speed + 3].copy()

    def _link(self, number: int, link: int) -> tuple[FloatArray, float, float]:
        """Handle (3,), position and velocity of a drawer or door; zeros where none is meant."""
        if link < 0:
            return np.zeros(3), 0.0, 0.0
        lane = self.lane(number)
        q = float(lane.qpos[lane.scene.link_qpos[link]])
        handles = self._handles[number]
        assert handles is not None
        return handles.one(link, q), q, float(lane.qvel[lane.scene.link_qvel[link]])

    def _way(self, number: int, errand: Errand) -> float:
        if errand.route is None:
            return 0.0
        return float(errand.route.at(self._robot[number : number + 1, :2])[0])

    def _hold_error(self, numbers: Sequence[int], sensors: Sensors) -> FloatArray:
        points = sensors.gripper.copy()
        for row, number in enumerate(numbers):
            lane = self.lane(number)
            if lane.held >= 0:
                points[row] = self._object(number, lane.held)[0][:3]
            elif lane.held_link >= 0:
                points[row] = self._link(number, lane.held_link)[0]
        return norm(points - sensors.gripper)


def _up_axis(quaternion: FloatArray) -> FloatArray:
    """The z axis of rotations given as (w, x, y, z). Shape (n, 4) -> (n, 3)."""
    w, x, y, z = quaternion.T
    return np.stack([2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)], axis=1)


_NOWHERE: tuple[Pose, FloatArray, Mapping[str, float], int] = (Pose(0.0, 0.0, 0.0), np.array(REST_ARM), {}, -1)
