"""A camera that follows the robot, from the direction with the best view of robot, hand and target."""

from __future__ import annotations

from itertools import product

import numpy as np

from perdure.home.sim.arrays import FloatArray
from perdure.home.sim.robot import gripper_pose
from perdure.home.sim.world import Simulator
from perdure.home.sim.world.simulator import ARM_FROM, ARM_TO, TORSO
from perdure.home.video.cameras import Shot

DIRECTIONS = np.array(list(product(np.arange(24) * (np.pi / 12.0), np.radians([24.0, 36.0, 50.0]))))
"""Azimuths and elevations that are tried, in [rad]: where the camera is, seen from what it looks at."""
NEAR, FAR = 2.9, 4.6
"""Distances of the camera in [m], with the target at the robot and with the target far away."""
REACH = 2.4
"""A target farther from the robot than this in [m] is driven to: the camera stays with the robot."""
STAY = 1.5
"""Score that a direction loses for each radian it is away from the present one."""
PATIENCE = 0.5
"""Time the camera keeps a direction before it searches a better one, in [s]."""
INERTIA = 0.6
"""Time constant of the camera's direction in [s] ..."""
TRACKING = 0.12
"""... and of the point it looks at: at 3 m/s and fourfold speed the robot is 1.4 m ahead of the picture's center."""


class Follower:
    """Remembers where the camera is, so that it glides instead of jumping. Times are those on the screen."""

    def __init__(self, simulator: Simulator) -> None:
        """A camera for one lane."""
        self._simulator = simulator
        self._now: FloatArray | None = None
        self._middle = np.zeros(3)
        self._wanted, self._age = np.zeros(2), np.inf
        self._partitions = _partition_geoms(simulator)

    def shot(self, focus: FloatArray | None = None, exclude: int = -1, seconds: float = 0.0) -> Shot:
        """Return the camera `seconds` later.

        `focus` is a point of the room besides the robot, shape (3,); the object of number `exclude` does not hide it.
        """
        robot, gripper = self._robot()
        way = np.zeros(3) if focus is None else focus - robot
        level = float(np.hypot(*way[:2]))
        near = level <= REACH
        share = 0.5 if near else 0.25 * REACH / max(level, 1e-9)
        middle = robot + share * way
        middle[2] = np.clip(0.5 * (robot[2] + (focus[2] if near and focus is not None else robot[2])), 0.5, 1.0)
        distance = NEAR + (FAR - NEAR) * min(level / REACH, 1.0) if focus is not None else 3.4
        if self._now is None or self._age >= PATIENCE:
            points = [gripper, robot + np.array([0.0, 0.0, 0.3])]
            if focus is not None and near:
                points.insert(0, focus)
            self._wanted, self._age = self._best(middle, distance, points, exclude), 0.0
        self._age += seconds
        aim = np.array([*self._wanted, distance])
        if self._now is None:
            self._now, self._middle = aim, middle
        share = 1.0 - np.exp(-seconds / INERTIA)
        change = aim - self._now
        change[0] = (change[0] + np.pi) % (2.0 * np.pi) - np.pi
        self._now = self._now + share * change
        self._middle = self._middle + (1.0 - np.exp(-seconds / TRACKING)) * (middle - self._middle)
        return Shot(self._middle + self._now[2] * direction_of(*self._now[:2]), self._middle)

    def _robot(self) -> tuple[FloatArray, FloatArray]:
        """Return the robot's chest and its gripper point in the room."""
        x, y, yaw = self._simulator.robot[:3]
        local, _ = gripper_pose(self._simulator.robot[TORSO], self._simulator.robot[ARM_FROM:ARM_TO])
        cos, sin = np.cos(yaw), np.sin(yaw)
        gripper = np.array([x + cos * local[0] - sin * local[1], y + sin * local[0] + cos * local[1], local[2]])
        return np.array([x, y, 0.7]), gripper

    def _best(self, middle: FloatArray, distance: float, points: list[FloatArray], exclude: int) -> FloatArray:
        """Return azimuth and elevation from which most can be seen. Shape (2,)."""
        scores = []
        for azimuth, elevation in DIRECTIONS:
            eye = middle + distance * direction_of(azimuth, elevation)
            seen = sum((2.0 - k) * self._sees(point, eye, exclude) for k, point in enumerate(points))
            turn = (
                0.3 if self._now is None else STAY / np.pi * abs((azimuth - self._now[0] + np.pi) % (2 * np.pi) - np.pi)
            )
            scores.append(seen - turn - 0.4 * abs(elevation - np.radians(34.0)) + 0.3 * self._beside(azimuth))
        return np.asarray(DIRECTIONS[int(np.argmax(scores))])

    def _beside(self, azimuth: float) -> float:
        """Return 1 for a view from the side, where the arm is visible, 0 from ahead or behind."""
        return float(abs(np.sin(azimuth - self._simulator.robot[2])))

    def _sees(self, point: FloatArray, eye: FloatArray, exclude: int) -> float:
        """Return 1 for a free line of sight, 0.4 when only the robot blocks it, else 0."""
        import mujoco

        geom = np.array([-1], dtype=np.int32)
        body = -1 if exclude < 0 else int(self._simulator.model.body(f"object_{exclude}").id)
        groups = np.array([1, 1, 1, 0, 0, 0], dtype=np.uint8)
        away = eye - point
        share = mujoco.mj_ray(self._simulator.model, self._simulator.data, point, away, groups, 1, body, geom)
        hit = int(geom[0])
        if hit < 0 or share >= 1.0:
            return 1.0
        if self._simulator.scene.robot_geoms[hit]:
            return 0.4
        # A ray that leaves the room crosses a wall that is cut away for this camera.
        return float(self._simulator.model.geom_group[hit] == 1 and hit not in self._partitions)


def direction_of(azimuth: float, elevation: float) -> FloatArray:
    """Return the direction of two angles in [rad]. Shape (3,)."""
    return np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])


def _partition_geoms(simulator: Simulator) -> frozenset[int]:
    names = [
        f"{wall.name}/{solid.name}"
        for wall in simulator.scene.apartment.walls
        if wall.name.startswith("partition")
        for solid in wall.solids
    ]
    return frozenset(int(simulator.model.geom(name).id) for name in names)
