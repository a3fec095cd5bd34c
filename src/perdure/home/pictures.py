"""Pictures of a home: a scene to render, cameras, walls cut away, marks of targets and goals."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np

from perdure.errors import PerdureError, lookup
from perdure.film import Picture, Renderer
from perdure.home.sim.apartments import cut_away
from perdure.home.sim.arrays import FloatArray, Vec3
from perdure.home.sim.objects import short_name
from perdure.home.sim.pieces import Apartment
from perdure.home.sim.scene import SceneOptions
from perdure.home.sim.simulator import Simulator
from perdure.home.tasks.episodes import Episode, episode_scene, start_pose
from perdure.home.tasks.tasks import AT

CAMERAS = dict.fromkeys(("doll_house", "plan", "follow", "head", "hand"))
"""The whole apartment like a doll's house or from above, the robot from where it is seen best, its own two cameras."""
LARGEST = 4096
NEAR = 0.02
"""Near clipping distance in [m]: the head looks along the upper arm."""
SHADOWS = 4096
"""Size of the shadow map in texels."""
SEEN = (1, 1, 1, 0, 0, 0)
"""Geom groups that are seen."""
FILL = ((0.8, 0.6, -0.12), (-0.8, -0.6, -0.12), (0.6, -0.8, -0.12), (-0.6, 0.8, -0.12))
"""Directions of lights without shadows: walls that look away from the sun and the camera would be gray."""
FILL_STRENGTH = 0.2
FOVY = 36.0
"""Vertical field of view in [deg]: narrower than MuJoCo's 45, so that furniture leans less."""
DOLL_HOUSE_ELEVATION = 52.0
"""How far the doll's house is looked down at in [deg]."""
LOW_WALL = 1.0
"""Height in [m] up to which a picture of the whole apartment shows its walls in any case."""
PIN = 0.35
"""Length of the pin over an object in [m]."""
COLORS = ((0.10, 0.42, 0.86), (0.86, 0.16, 0.46), (0.10, 0.60, 0.28), (0.93, 0.50, 0.08), (0.47, 0.30, 0.80))
"""One for each target, red, green and blue in [0, 1]."""

AZIMUTHS = np.arange(24) * (np.pi / 12.0)
DIRECTIONS = np.array(list(product(AZIMUTHS, np.radians([24.0, 36.0, 50.0]))))
"""Azimuths and elevations that `follow` tries, in [rad]: where the camera is, seen from what it looks at."""
CLOSE, FAR = 2.9, 4.6
"""Distances of the following camera in [m], with the target at the robot and with the target far away."""
REACH = 2.4
"""A target farther from the robot than this in [m] is driven to: the camera stays with the robot."""
STAY = 1.5
"""Score that a direction loses if it is opposite to the present one."""
PATIENCE = 0.5
"""Time the camera keeps a direction before it searches a better one, in [s]."""
INERTIA = 0.6
"""Time constant of the camera's direction in [s] ..."""
TRACKING = 0.12
"""... and of the point it looks at: at 3 m/s and fourfold speed the robot is 1.4 m ahead of the picture's center."""


def render_scene(episode: Episode, eval_seed: int) -> Simulator:
    """Return a copy of an episode's scene with visual geometry, at the start of the episode.

    Visual geometry in the simulated scene would change the last bits of the physics, and with them the trajectory. So
    episodes run without it, and this scene is set to the same positions (`put`) before each picture.
    """
    scene = episode_scene(episode, SceneOptions(visuals=True))
    simulator = Simulator(scene)
    simulator.reset(start_pose(scene.apartment, episode, eval_seed))
    return simulator


def put(simulator: Simulator, qpos: FloatArray) -> None:
    """Set all positions of a simulator to those of another one of the same episode. Shape (nq,)."""
    simulator.qpos[:] = qpos
    simulator.forward()


@dataclass(frozen=True)
class Mark:
    """A target and its goal: a pin over the object, a translucent ball at the goal, both in one color."""

    label: str
    goal: Vec3
    """Goal position in the room in [m]."""
    color: Vec3
    number: int
    """Of the object in the scene."""


def goal_marks(episode: Episode) -> tuple[Mark, ...]:
    """Return one mark for each target of an episode."""
    return tuple(
        Mark(short_name(goal.kind), goal.position, COLORS[k % len(COLORS)], k) for k, goal in enumerate(episode.goals)
    )


@dataclass(frozen=True, eq=False)
class Shot:
    """A camera in the room that looks from `eye` at `target`, the horizon level."""

    eye: FloatArray
    """Shape (3,), in [m]."""
    target: FloatArray
    """Shape (3,), in [m]."""
    up: Vec3 = (0.0, 0.0, 1.0)
    """Upward direction in the picture; north for a camera that looks straight down."""

    @property
    def axes(self) -> FloatArray:
        """Rows: right, up and forward of the picture in the room. Shape (3, 3)."""
        forward = (self.target - self.eye) / np.linalg.norm(self.target - self.eye)
        right = np.cross(forward, self.up)
        right /= np.linalg.norm(right)
        return np.stack([right, np.cross(right, forward), forward])


def whole_apartment(apartment: Apartment, camera: str, size: tuple[int, int]) -> Shot:
    """Return the camera `doll_house` or `plan`, as near as the whole apartment fits into the picture."""
    corners, up = np.array(apartment.room), (0.0, 0.0, 1.0)
    points = np.concatenate([np.c_[corners, np.full(len(corners), z)] for z in (0.0, LOW_WALL)])
    if camera == "plan":
        backward, up = np.array([0.0, 0.0, 1.0]), (0.0, 1.0, 0.0)
    else:
        yaw = next((p.pose.yaw for p in apartment.pieces if p.kind == "kitchen_counter"), 0.5 * np.pi)
        backward = direction_of(yaw, np.radians(DOLL_HOUSE_ELEVATION))
    target, distance = np.array([*(0.5 * (corners.min(axis=0) + corners.max(axis=0))), 0.0]), 30.0
    tangents = np.tan(np.radians(0.5 * FOVY)) * np.array([size[0] / size[1], 1.0])
    for _ in range(8):
        axes = Shot(target + distance * backward, target, up).axes
        right, upward, depth = axes @ (points - target).T
        seen = np.stack([right, upward], axis=1) / tangents / (distance + depth[:, None])
        low, high = seen.min(axis=0), seen.max(axis=0)
        target = target + 0.5 * distance * (low + high) * tangents @ axes[:2]
        distance *= 0.5 * float(np.max(high - low)) / 0.95
    return Shot(target + distance * backward, target, up)


def direction_of(azimuth: float, elevation: float) -> FloatArray:
    """Return the direction of two angles in [rad]. Shape (3,)."""
    return np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])


class Studio(Renderer):
    """Takes pictures of one simulator. Use it as a context manager in the thread that made it."""

    def __init__(self, simulator: Simulator, size: tuple[int, int] = (900, 600)) -> None:
        """Set up lights and camera.

        Args:
            simulator: What to take pictures of; its scene should be built with visuals. It is not changed.
            size: Width and height of the pictures in pixels.

        Raises:
            PerdureError: If the size is not possible.
            PerdureError: If no picture can be drawn on this machine.
        """
        if not all(16 <= side <= LARGEST for side in size):
            raise PerdureError(f"a picture must be 16 to {LARGEST} pixels wide and high, not {size[0]} x {size[1]}")
        model = copy(simulator.model)  # walls are cut away in this one
        model.vis.global_.fovy = FOVY
        model.vis.map.znear = NEAR / model.stat.extent  # MuJoCo counts it in sizes of the model
        model.vis.headlight.ambient[:], model.vis.headlight.diffuse[:] = 0.42, 0.14
        super().__init__(model, size, SHADOWS)
        self.simulator, self._colors = simulator, model.geom_rgba.copy()
        self.options.geomgroup[:] = SEEN
        self.options.sitegroup[:] = 0

    def take(self, camera: str | Shot, marks: Sequence[Mark] = ()) -> Picture:
        """Return a picture of the simulator as it is now.

        Args:
            camera: One of `CAMERAS`, or a shot of one's own.
            marks: Targets and goals to show.
        """
        m = self._mujoco
        made, apartment = m.MjvCamera(), self.simulator.scene.apartment
        if isinstance(camera, str):
            lookup(CAMERAS, camera, "camera")
        if camera in ("head", "hand"):
            made.type, made.fixedcamid = m.mjtCamera.mjCAMERA_FIXED, self.model.camera(camera).id
        else:
            if camera == "follow":
                camera = Follower(self.simulator).shot()
            shot = camera if isinstance(camera, Shot) else whole_apartment(apartment, camera, self.size)
            self.model.geom_rgba[:] = self._colors
            cut_away(self.model, apartment, shot.eye)
            _, up, forward = shot.axes
            level = up if abs(forward[2]) > 0.9999 else forward
            made.type = m.mjtCamera.mjCAMERA_FREE
            made.azimuth = np.degrees(np.arctan2(level[1], level[0]))
            made.elevation = np.degrees(np.arcsin(np.clip(forward[2], -1.0, 1.0)))
            made.distance, made.lookat[:] = np.linalg.norm(shot.target - shot.eye), shot.target
        return self.draw(self.simulator.data, made, lambda: self._decorate(marks))

    def _decorate(self, marks: Sequence[Mark]) -> None:
        scene, geoms = self.scene, self._mujoco.mjtGeom
        for direction in FILL[: len(scene.lights) - scene.nlight]:
            light = scene.lights[scene.nlight]
            light.dir[:] = direction
            light.type, light.castshadow, light.headlight = self._mujoco.mjtLightType.mjLIGHT_DIRECTIONAL, 0, 0
            light.ambient[:], light.diffuse[:], light.specular[:] = 0.0, FILL_STRENGTH, 0.0
            scene.nlight += 1
        for mark in marks:
            goal, place = np.array(mark.goal), self.simulator.object(mark.number)[0][:3]
            pin = place + np.array([0.0, 0.0, 0.13 + PIN])
            self._add(geoms.mjGEOM_SPHERE, (AT,) * 3, goal, mark.color, 0.32, f"goal: {mark.label}")
            self._add(geoms.mjGEOM_SPHERE, (0.018,) * 3, goal, mark.color, 1.0)
            self._add(geoms.mjGEOM_ARROW, (0.012, 0.012, PIN), pin, mark.color, 0.95, mark.label)

    def _add(self, kind: Any, size: Vec3, place: FloatArray, color: Vec3, alpha: float, label: str = "") -> None:
        """Add a geom with its z-axis down; inside a goal's ball, an object counts as at its goal."""
        if self.scene.ngeom < self.scene.maxgeom:
            geom = self.scene.geoms[self.scene.ngeom]
            rgba, down = np.array([*color, alpha], dtype=np.float32), np.diag([1.0, -1.0, -1.0]).ravel()
            self._mujoco.mjv_initGeom(geom, kind, np.array(size), place, down, rgba)
            geom.category, geom.label = self._mujoco.mjtCatBit.mjCAT_DECOR, label
            geom.emission, geom.specular = 0.35, 0.0
            self.scene.ngeom += 1


class Follower:
    """A camera that follows the robot, from the direction with the best view of robot, hand and target.

    It remembers where it is, so that it glides instead of jumping. Times are those on the screen.
    """

    def __init__(self, simulator: Simulator) -> None:
        """Follow the robot of one simulator, whose derived positions are up to date."""
        self.simulator = simulator
        self._now: FloatArray | None = None
        self._middle = np.zeros(3)
        self._wanted, self._age = np.zeros(2), np.inf
        partitions = (wall for wall in simulator.scene.apartment.walls if wall.name.startswith("partition"))
        names = [f"{wall.name}/{solid.name}" for wall in partitions for solid in wall.solids]
        self._partitions = frozenset(int(simulator.model.geom(name).id) for name in names)

    def shot(self, focus: FloatArray | None = None, exclude: int = -1, seconds: float = 0.0) -> Shot:
        """Return the camera `seconds` later.

        `focus` is a point of the room besides the robot, shape (3,); the object of number `exclude` does not hide it.
        """
        robot = np.array([*self.simulator.robot[:2], 0.7])
        way = np.zeros(3) if focus is None else focus - robot
        level = float(np.hypot(*way[:2]))
        near = focus is not None and level <= REACH
        middle = robot + (0.5 if near else 0.25 * REACH / max(level, 1e-9)) * way
        middle[2] = np.clip(robot[2] + (0.5 * way[2] if near else 0.0), 0.5, 1.0)
        distance = CLOSE + (FAR - CLOSE) * (0.3 if focus is None else min(level / REACH, 1.0))
        if self._now is None or self._age >= PATIENCE:
            points = [self.simulator.gripper, robot + np.array([0.0, 0.0, 0.3])]
            if near and focus is not None:
                points.insert(0, focus)
            self._wanted, self._age = self._best(middle, distance, points, exclude), 0.0
        self._age += seconds
        aim = np.array([*self._wanted, distance])
        if self._now is None:
            self._now, self._middle = aim, middle
        change = aim - self._now
        change[0] = (change[0] + np.pi) % (2.0 * np.pi) - np.pi
        self._now = self._now + (1.0 - np.exp(-seconds / INERTIA)) * change
        self._middle = self._middle + (1.0 - np.exp(-seconds / TRACKING)) * (middle - self._middle)
        return Shot(self._middle + self._now[2] * direction_of(*self._now[:2]), self._middle)

    def _best(self, middle: FloatArray, distance: float, points: Sequence[FloatArray], exclude: int) -> FloatArray:
        """Return azimuth and elevation from which most can be seen. Shape (2,)."""
        azimuths, elevations = DIRECTIONS.T
        eyes = [middle + distance * direction_of(*direction) for direction in DIRECTIONS]
        scores = np.array([sum((2.0 - k) * self.sees(p, eye, exclude) for k, p in enumerate(points)) for eye in eyes])
        scores -= 0.4 * np.abs(elevations - np.radians(34.0))
        scores += 0.3 * np.abs(np.sin(azimuths - self.simulator.robot[2]))  # from the side the arm is visible
        if self._now is not None:
            scores -= STAY / np.pi * np.abs((azimuths - self._now[0] + np.pi) % (2 * np.pi) - np.pi)
        return np.asarray(DIRECTIONS[int(np.argmax(scores))])

    def sees(self, point: FloatArray, eye: FloatArray, exclude: int) -> float:
        """Return 1 for a free line of sight, 0.4 when only the robot blocks it, else 0. Points of shape (3,)."""
        import mujoco

        model, geom, groups = self.simulator.model, np.array([-1], dtype=np.int32), np.array(SEEN, dtype=np.uint8)
        body = -1 if exclude < 0 else int(model.body(f"object_{exclude}").id)
        share = mujoco.mj_ray(model, self.simulator.data, point, eye - point, groups, 1, body, geom)
        hit = int(geom[0])
        if hit < 0 or share >= 1.0:
            return 1.0
        if self.simulator.scene.robot_geoms[hit]:
            return 0.4
        # A ray that leaves the room crosses a wall that is cut away for this camera.
        return float(model.geom_group[hit] == 1 and hit not in self._partitions)
