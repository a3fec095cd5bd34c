"""Pictures of a home: a scene to render, cameras, walls cut away, marks of targets and goals."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from itertools import pairwise, product
from typing import Any

import numpy as np

from perdure.errors import PerdureError, lookup
from perdure.film import Color, Picture, Renderer, write_labels
from perdure.home.sim.apartments import cut_away
from perdure.home.sim.arrays import FloatArray, Vec3
from perdure.home.sim.objects import short_name
from perdure.home.sim.pieces import Apartment
from perdure.home.sim.robot import ROBOT
from perdure.home.sim.scene import SceneOptions
from perdure.home.sim.simulator import Simulator
from perdure.home.tasks.episodes import Episode, episode_scene, start_pose
from perdure.home.tasks.tasks import AT

CAMERAS = dict.fromkeys(("doll_house", "plan", "follow", *ROBOT.cameras))
"""The whole apartment like a doll's house or from above, the robot from where it is seen best, its own two cameras."""
LARGEST = 4096
NEAR = 0.02
"""Near clipping distance in [m]: the head looks along the upper arm."""
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
PIN_GAP = 0.13
"""Length of the pin over an object, and its distance from the object's middle, in [m]; no pin where a path is drawn."""
COLORS = ((25, 107, 219), (219, 41, 117), (25, 153, 71), (237, 128, 20), (120, 77, 204))
"""One for each target."""
PATH_RADIUS = 0.005
"""Of the line that an object leaves, in [m]."""
UP = np.array([0.0, 0.0, 1.0])
Line = Sequence[tuple[FloatArray, Color]]

DIRECTIONS = np.array(list(product(np.arange(24) * (np.pi / 12.0), np.radians([12.0, 24.0, 36.0, 50.0, 65.0]))))
"""Azimuths and elevations that are tried, in [rad]: where the camera is, seen from what it looks at."""
USUAL_ELEVATION = np.radians(36.0)
CLOSE = 2.9
FAR = 4.6
"""Distances of the following camera in [m], with the target at the robot and with the target far away."""
NEAREST = 1.3
ZOOM = 1.7
"""Other cameras are NEAREST + ZOOM * (distance of the two things they look at) away, FAR at most, in [m]."""
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
    color: Color
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

    def project(self, points: FloatArray, size: tuple[int, int]) -> FloatArray:
        """Return where points (n, 3) are in a picture, from -1 (left, bottom) to 1; nan behind it. Shape (n, 2)."""
        right, up, depth = self.axes @ (points - self.eye).T
        tangents = np.tan(np.radians(0.5 * FOVY)) * np.array([size[0] / size[1], 1.0])
        return np.asarray(np.stack([right, up], axis=1) / tangents / np.where(depth > 0.0, depth, np.nan)[:, None])

    @property
    def axes(self) -> FloatArray:
        """Rows: right, up and forward of the picture in the room. Shape (3, 3)."""
        forward = (self.target - self.eye) / np.linalg.norm(self.target - self.eye)
        right = np.cross(forward, self.up)
        right /= np.linalg.norm(right)
        return np.stack([right, np.cross(right, forward), forward])


def overview(apartment: Apartment, camera: str, size: tuple[int, int], corners: FloatArray | None = None) -> Shot:
    """Return the camera `doll_house` or `plan`, as near as corners (n, 2), or the whole apartment, fit into it."""
    if corners is None:
        corners = np.array(apartment.room)
    points = np.concatenate([np.c_[corners, np.full(len(corners), z)] for z in (0.0, LOW_WALL)])
    if camera == "plan":
        backward = np.array([0.0, 0.0, 1.0])
        up = (0.0, 1.0, 0.0)
    else:
        yaw = next((p.pose.yaw for p in apartment.pieces if p.kind == "kitchen_counter"), 0.5 * np.pi)
        backward = direction_of(yaw, np.radians(DOLL_HOUSE_ELEVATION))
        up = (0.0, 0.0, 1.0)

    # Look at the middle of what is seen, from so far that it just fits; a few steps are enough.
    target = np.array([*(0.5 * (corners.min(axis=0) + corners.max(axis=0))), 0.0])
    distance = 30.0
    tangents = np.tan(np.radians(0.5 * FOVY)) * np.array([size[0] / size[1], 1.0])
    for _ in range(8):
        shot = Shot(target + distance * backward, target, up)
        seen = shot.project(points, size)
        low = seen.min(axis=0)
        high = seen.max(axis=0)
        target = target + 0.5 * distance * (low + high) * tangents @ shot.axes[:2]
        distance *= 0.5 * float(np.max(high - low)) / 0.95
    return Shot(target + distance * backward, target, up)


def direction_of(azimuth: float, elevation: float) -> FloatArray:
    """Return the direction of two angles in [rad]. Shape (3,)."""
    return np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])


class Studio(Renderer):
    """A `Renderer` of one simulator, built with visuals and not changed; PerdureError if the size is not possible."""

    shadows = 4096

    def __init__(self, simulator: Simulator, size: tuple[int, int] = (900, 600)) -> None:
        if not all(16 <= side <= LARGEST for side in size):
            raise PerdureError(f"a picture must be 16 to {LARGEST} pixels wide and high, not {size[0]} x {size[1]}")
        model = copy(simulator.model)  # walls are cut away in this one
        model.vis.global_.fovy = FOVY
        model.vis.map.znear = NEAR / model.stat.extent  # MuJoCo counts it in sizes of the model
        model.vis.headlight.ambient[:] = 0.42
        model.vis.headlight.diffuse[:] = 0.14
        super().__init__(model, size)
        self.simulator = simulator
        self._colors = model.geom_rgba.copy()
        self.options.geomgroup[:] = SEEN
        self.options.sitegroup[:] = 0

    def take(self, camera: str | Shot, marks: Sequence[Mark] = (), path: Line = ()) -> Picture:
        """Return a picture of the simulator as it is now.

        Args:
            camera: One of `CAMERAS`, or a shot of one's own.
            marks: Targets and goals to show.
            path: Points (3,) of a line, each with the color of the line to it.
        """
        if isinstance(camera, str):
            lookup(CAMERAS, camera, "camera")
        if isinstance(camera, str) and camera in ROBOT.cameras:
            made = self._mujoco.MjvCamera()
            made.type = self._mujoco.mjtCamera.mjCAMERA_FIXED
            made.fixedcamid = self.model.camera(camera).id
            return self.draw(self.simulator.data, made, lambda: self._decorate(marks, path))

        if camera == "follow":
            camera = Follower(self.simulator).shot()
        apartment = self.simulator.scene.apartment
        if isinstance(camera, str):
            camera = overview(apartment, camera, self.size)
        self.model.geom_rgba[:] = self._colors
        cut_away(self.model, apartment, camera.eye)
        picture = self.draw(self.simulator.data, self._free_camera(camera), lambda: self._decorate(marks, path))
        labels = [label for mark in marks for label in self._labels(mark, camera, path)]
        return write_labels(picture, labels)

    def _free_camera(self, shot: Shot) -> Any:
        """Return MuJoCo's camera of a shot."""
        _, up, forward = shot.axes
        level = forward
        if abs(forward[2]) > 0.9999:  # it looks straight down
            level = up
        made = self._mujoco.MjvCamera()
        made.type = self._mujoco.mjtCamera.mjCAMERA_FREE
        made.azimuth = np.degrees(np.arctan2(level[1], level[0]))
        made.elevation = np.degrees(np.arcsin(np.clip(forward[2], -1.0, 1.0)))
        made.distance = np.linalg.norm(shot.target - shot.eye)
        made.lookat[:] = shot.target
        return made

    def _labels(self, mark: Mark, shot: Shot, path: Line) -> list[tuple[float, float, str, Color]]:
        """Return the labels of an object and of its goal in a picture: position in pixels, text, color."""
        goal = np.array(mark.goal)
        place = self.simulator.object(mark.number)[0][:3]
        tops = {}
        if not path:
            tops[mark.label] = place + (PIN_GAP + PIN) * UP
        if path or np.linalg.norm(place - goal) > AT:
            tops[f"goal: {mark.label}"] = goal + AT * UP
        at = 0.5 * (1.0 + shot.project(np.array([*tops.values()]), self.size) * (1.0, -1.0)) * self.size
        return [(x, y, text, mark.color) for text, (x, y) in zip(tops, at.tolist(), strict=True)]

    def _decorate(self, marks: Sequence[Mark], path: Line) -> None:
        """Add lights, marks and a line to MuJoCo's scene."""
        scene = self.scene
        geoms = self._mujoco.mjtGeom

        # Lights from the sides.
        for direction in FILL[: len(scene.lights) - scene.nlight]:
            light = scene.lights[scene.nlight]
            light.dir[:] = direction
            light.type = self._mujoco.mjtLightType.mjLIGHT_DIRECTIONAL
            light.castshadow = 0
            light.headlight = 0
            light.ambient[:] = 0.0
            light.diffuse[:] = FILL_STRENGTH
            light.specular[:] = 0.0
            scene.nlight += 1

        # Targets and goals. Where a line is drawn it shows where the target is, and is seen through the ball.
        for mark in marks:
            goal = np.array(mark.goal)
            self._add(geoms.mjGEOM_SPHERE, (AT,) * 3, goal, mark.color, 0.2 if path else 0.32)
            self._add(geoms.mjGEOM_SPHERE, (0.018,) * 3, goal, mark.color, 1.0)
            if not path:
                pin = self.simulator.object(mark.number)[0][:3] + (PIN_GAP + PIN) * UP
                self._add(geoms.mjGEOM_ARROW, (0.012, 0.012, PIN), pin, mark.color, 0.95)

        # The line.
        for (start, _), (end, color) in pairwise(path):
            line = self._add(geoms.mjGEOM_CAPSULE, (1.0,) * 3, start, color, 1.0)
            self._mujoco.mjv_connector(line, geoms.mjGEOM_CAPSULE, PATH_RADIUS, start, end)

    def _add(self, kind: Any, size: Vec3, place: FloatArray, color: Color, alpha: float) -> Any:
        """Add a geom with its z-axis down and return it; inside a goal's ball, an object counts as at its goal."""
        geom = self.scene.geoms[self.scene.ngeom]
        rgba = np.array([*np.divide(color, 255.0), alpha], dtype=np.float32)
        self._mujoco.mjv_initGeom(geom, kind, np.array(size), place, np.diag([1.0, -1.0, -1.0]).ravel(), rgba)
        geom.category = self._mujoco.mjtCatBit.mjCAT_DECOR
        geom.emission = 0.35
        geom.specular = 0.0
        self.scene.ngeom += 1
        return geom


class Follower:
    """A camera that follows the robot, from the direction with the best view of robot, hand and target.

    It remembers where it is, so that it glides instead of jumping. Times are those on the screen. The simulator's
    derived positions must be up to date.
    """

    def __init__(self, simulator: Simulator) -> None:
        self.simulator = simulator
        self._now: FloatArray | None = None
        self._middle = np.zeros(3)
        self._wanted = np.zeros(2)
        self._age = np.inf
        self._model = copy(simulator.model)  # walls are cut away in this one
        self._colors = self._model.geom_rgba.copy()

    def shot(self, focus: FloatArray | None = None, exclude: int = -1, seconds: float = 0.0) -> Shot:
        """Return the camera `seconds` later.

        `focus` is a point of the room besides the robot, shape (3,); the object of number `exclude` does not hide it.
        """
        # The point to look at, and from how far: between robot and focus, but not farther than the robot reaches.
        robot = np.array([*self.simulator.robot[:2], 0.7])
        points = [self.simulator.gripper, robot + np.array([0.0, 0.0, 0.3])]
        middle = robot.copy()
        distance = CLOSE + (FAR - CLOSE) * 0.3
        if focus is not None:
            way = focus - robot
            level = float(np.hypot(*way[:2]))
            distance = CLOSE + (FAR - CLOSE) * min(level / REACH, 1.0)
            if level <= REACH:
                middle = robot + 0.5 * way
                points.insert(0, focus)
            else:
                middle = robot + 0.25 * REACH / max(level, 1e-9) * way
                middle[2] = robot[2]
        middle[2] = np.clip(middle[2], 0.5, 1.0)

        # The direction, which the camera keeps for a while.
        if self._now is None or self._age >= PATIENCE:
            self._wanted = self._best(middle, distance, points, exclude)
            self._age = 0.0
        self._age += seconds

        # Glide toward both, the shorter way round.
        aim = np.array([*self._wanted, distance])
        if self._now is None:
            self._now = aim
            self._middle = middle
        change = aim - self._now
        change[0] = (change[0] + np.pi) % (2.0 * np.pi) - np.pi
        self._now = self._now + (1.0 - np.exp(-seconds / INERTIA)) * change
        self._middle = self._middle + (1.0 - np.exp(-seconds / TRACKING)) * (middle - self._middle)
        return Shot(self._middle + self._now[2] * direction_of(*self._now[:2]), self._middle)

    def _best(self, middle: FloatArray, distance: float, points: Sequence[FloatArray], exclude: int) -> FloatArray:
        """Return azimuth and elevation from which most can be seen. Shape (2,)."""
        azimuths = DIRECTIONS[:, 0]
        scores = self._scores(middle, distance, points, exclude)
        scores += 0.3 * np.abs(np.sin(azimuths - self.simulator.robot[2]))  # from the side the arm is visible
        if self._now is not None:
            scores -= STAY / np.pi * np.abs((azimuths - self._now[0] + np.pi) % (2 * np.pi) - np.pi)
        return np.asarray(DIRECTIONS[int(np.argmax(scores))])

    def _scores(self, middle: FloatArray, distance: float, points: Sequence[FloatArray], exclude: int) -> FloatArray:
        """Return how well points are seen, the first one counting most, from each of `DIRECTIONS`. Shape (n,)."""
        eyes = [middle + distance * direction_of(*direction) for direction in DIRECTIONS]
        seen = [sum((2.0 - k) * self.sees(p, eye, exclude) for k, p in enumerate(points)) for eye in eyes]
        return np.asarray(np.array(seen) - 0.4 * np.abs(DIRECTIONS[:, 1] - USUAL_ELEVATION))

    def fixed(self, states: Sequence[FloatArray], pairs: Sequence[FloatArray], exclude: int) -> list[Shot]:
        """Return a shot for each state (nq,), all from the one direction with the fewest occlusions.

        Each shows two points (2, 3), the more important one first. The object of number `exclude` does not hide itself.
        """
        total = np.zeros(len(DIRECTIONS))
        framings = []
        for state, pair in zip(states, pairs, strict=True):
            put(self.simulator, state)
            middle = pair.mean(axis=0)
            distance = min(NEAREST + ZOOM * float(np.linalg.norm(pair[0] - pair[1])), FAR)
            framings.append((middle, distance))
            total += self._scores(middle, distance, list(pair), exclude)
        best = direction_of(*DIRECTIONS[int(np.argmax(total))])
        return [Shot(middle + distance * best, middle) for middle, distance in framings]

    def sees(self, point: FloatArray, eye: FloatArray, exclude: int) -> float:
        """Return 1 for a free line of sight, 0.4 when only the robot blocks it, else 0. Points of shape (3,)."""
        import mujoco

        model = self._model
        geom = np.array([-1], dtype=np.int32)
        groups = np.array(SEEN, dtype=np.uint8)
        model.geom_rgba[:] = self._colors
        cut_away(model, self.simulator.scene.apartment, eye)  # a ray passes through what is invisible
        body = -1 if exclude < 0 else int(model.body(f"object_{exclude}").id)
        share = mujoco.mj_ray(model, self.simulator.data, point, eye - point, groups, 1, body, geom)
        hit = int(geom[0])
        if hit < 0 or share >= 1.0:
            return 1.0
        if self.simulator.scene.robot_geoms[hit]:
            return 0.4
        return 0.0
