"""Start states of skills: where the robot can stand, its arm, what is open, which episodes they are drawn from."""

from __future__ import annotations

import hashlib
import math
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import lru_cache
from importlib.metadata import version
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from perdure.errors import PerdureError
from perdure.home.sim.apartments import split_apartments
from perdure.home.sim.arrays import BoolArray, FloatArray, IntArray, Quaternion, Vec3
from perdure.home.sim.hand import GRASP_RADIUS
from perdure.home.sim.kinematics import about_z, gripper_in_room, gripper_pose, toward
from perdure.home.sim.objects import Placement
from perdure.home.sim.occupancy import FreeSpace, free_space
from perdure.home.sim.pieces import Apartment, Pose, container_of
from perdure.home.sim.robot import ROBOT
from perdure.home.sim.scene import Scene
from perdure.home.sim.sensors import SkillGoal
from perdure.home.sim.simulator import Simulator
from perdure.home.sim.vector_simulator import VectorSimulator
from perdure.home.tasks.episodes import Episode, EpisodeSet, read_episodes, write_episodes
from perdure.home.tasks.generation import generate_episode
from perdure.home.tasks.tasks import get_task
from perdure.schema import Record, read_json


@dataclass(frozen=True, eq=False)
class Start:
    """The state in which a skill begins. Objects are numbered as in a scene that has the skill's target only."""

    base: Pose
    arm: FloatArray
    """Joint angles of the arm. Shape (joints,)."""
    skill_goal: SkillGoal
    opened: Mapping[str, float] = field(default_factory=dict)
    """Positions of drawers and doors that differ from the episode's, by link name."""
    held: int = -1
    """Number of the held object, -1 for none."""
    moved: Mapping[int, Placement] = field(default_factory=dict)
    """Placements of objects that have moved since the episode's start, by number."""


class PlanStart(Record, frozen=True):
    """The state before a skill of a task's plan; `perdure.home.evaluate.plan_starts` records it."""

    episode: int
    """Number in the pool of training episodes."""
    step: tuple[str, int, str | None]
    """Skill, target and, for navigate, the next skill."""
    attempt: int
    """From 1; navigations count as the skill that they lead to."""
    seen: tuple[str, Vec3]
    """Where the planner takes the target to be: receptacle and position."""
    stood: tuple[tuple[float, float], ...]
    """Where earlier attempts stood."""
    base: Vec3
    arm: tuple[float, ...]
    opened: dict[str, float]
    pose: tuple[Vec3, Quaternion]
    """Of the target."""


Draw = Callable[[Episode, int, np.random.Generator], Start]
"""Draws a start state for (episode, target), without a check for contacts."""
TRIES = 1000
"""Largest number of draws for one start state; published episodes need a few dozen at most."""
TOUCH = 0.001
"""Largest penetration depth of the robot, or of what it holds, at the start in [m] (our choice)."""


def begin(
    world: VectorSimulator, lane: int, scene: Scene, draw: Draw, episode: Episode, target: int, rng: np.random.Generator
) -> Start:
    """Bring a lane to a start state without contacts, drawn with `draw` until there is one.

    The scene is the episode's with `SceneOptions(targets=(target,))`. PerdureError if all of 1000 draws have contacts.
    """
    for _ in range(TRIES):
        start = draw(episode, target, rng)
        put(world, lane, scene, start)
        if touching(world.simulator(lane)) <= TOUCH:
            return start
    raise PerdureError(
        f"{episode.name}: the robot touches something in all of {TRIES} start states drawn for {target=}"
    )


def put(world: VectorSimulator, lane: int, scene: Scene, start: Start) -> None:
    """Bring a lane to a start state."""
    world.reset(lane, scene, start.base, start.arm, start.opened, start.held, start.skill_goal, start.moved)


def touching(lane: Simulator) -> float:
    """Return the penetration depth of the robot, or of what it holds, in [m], 0 without contact."""
    scene = lane.scene
    geoms = lane.data.contact.geom
    distance = lane.data.contact.dist
    if not len(distance):
        return 0.0
    ours = scene.robot_geoms[geoms]
    if lane.held >= 0:
        ours |= np.isin(geoms, scene.object_geoms[lane.held])
    between = ours[:, 0] != ours[:, 1]
    if not between.any():
        return 0.0
    return float(max(0.0, -distance[between].min()))


SPREAD = 0.025
FARTHEST = 0.05
"""Noise of the gripper point per axis in [m]: standard deviation and clip (M3)."""
REST_POSES = 1024
"""Number of poses that are solved once; start states draw from them (our choice)."""
REACHED = 0.001
"""Largest error per axis of a solved pose in [m]."""


def draw_arm(rng: np.random.Generator) -> FloatArray:
    """Draw joint angles of the arm: the gripper point at rest plus N(0, 0.025 m) per axis, clipped at 0.05 m.

    Shape (joints,).
    """
    poses = rest_poses()
    return np.asarray(poses[int(rng.integers(len(poses)))])


@lru_cache(maxsize=1)
def rest_poses() -> FloatArray:
    """Return poses with the gripper oriented as at rest, without those beyond the wrist's limit. (n, joints)."""
    rng = np.random.Generator(np.random.PCG64(0))
    points = ROBOT.rest_position + np.clip(rng.normal(0.0, SPREAD, (REST_POSES, 3)), -FARTHEST, FARTHEST)
    arm = np.tile(ROBOT.rest_arm, (REST_POSES, 1))
    upright = gripper_pose(ROBOT.torso_height, ROBOT.rest_arm)[1]
    for _ in range(30):
        arm = arm + toward(arm, points - gripper_pose(ROBOT.torso_height, arm)[0], rotation=upright, largest=0.2)
    reached = np.abs(points - gripper_pose(ROBOT.torso_height, arm)[0]).max(axis=1) < REACHED
    found: FloatArray = arm[reached]
    found.flags.writeable = False
    return found


STEEPEST = 0.5 * np.pi
"""Largest downward angle in [rad] at which an object was grasped, for start states that hold one (our choice)."""


def draw_held(placement: Placement, base: Pose, arm: FloatArray, rng: np.random.Generator) -> Placement:
    """Draw how an object is held that was grasped upright: where it is before the fingers, in the room.

    The hand came at an angle from level to straight down, on any side, and has turned since to where the arm is, shape
    (joints,). Hand and object then close the distance, see `Hand.hold_from_start`.
    """
    import mujoco

    position, now = gripper_in_room(base, arm)
    slope = STEEPEST * float(rng.random())
    cos = np.cos(slope)
    sin = np.sin(slope)
    then = np.array([[cos, 0.0, sin], [0.0, 1.0, 0.0], [-sin, 0.0, cos]])
    axes = now @ then.T @ about_z(2.0 * np.pi * float(rng.random()))
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(axes).ravel())
    x, y, z = (position + GRASP_RADIUS * now[:, 0]).tolist()
    qw, qx, qy, qz = quaternion.tolist()
    return replace(placement, position=(x, y, z), quaternion=(qw, qx, qy, qz))


NEAR = 2.0
"""Largest distance from the object or goal at which pick or place begins in [m] (M3)."""
IN_FRONT = 0.5
"""Cosine of the largest angle from a container's open side at which the robot begins (our choice)."""
POSITION_NOISE = 0.1
POSITION_CLIP = 0.2
"""Noise of the base position per axis in [m]: standard deviation and clip (M3)."""
HEADING_NOISE = 0.25
HEADING_CLIP = 0.5
"""Noise of the heading in [rad]: standard deviation and clip (M3)."""


@dataclass(frozen=True)
class Rectangle:
    """A rectangle on the floor in front of furniture: x away from the furniture, y to its left, in [m]."""

    x: tuple[float, float]
    half_width: float

    def contains(self, local: FloatArray) -> BoolArray:
        """Return which points of the rectangle's frame are inside. Shape (n, 2) -> (n,)."""
        x = local[:, 0]
        return (x >= self.x[0]) & (x <= self.x[1]) & (np.abs(local[:, 1]) <= self.half_width)


def stand_near(
    apartment: Apartment,
    point: tuple[float, float, float],
    rng: np.random.Generator,
    front: tuple[float, float] | None = None,
) -> Pose:
    """Draw a cell within 2.0 m of a point, with noise, facing the point.

    Cells are those that are free with all drawers and doors closed, also in `stand_in` (M3's navigation mesh is fixed,
    too). A robot that touches an open one is found by the contact check of `begin`.

    `front` is the direction of a container's open side. The cell is within 60 degrees of it (our choice: beside our
    fridge there is floor, which navigation never ends on).
    """
    return _draw(_cells_near(apartment, point[:2], front), point, rng)


def stand_in(
    apartment: Apartment,
    frame: Pose,
    rectangles: tuple[Rectangle, ...],
    point: tuple[float, float, float],
    rng: np.random.Generator,
) -> Pose:
    """Draw a cell of the first of some rectangles that has a free one, with noise, facing a point.

    The rectangles are in `frame`. PerdureError if none contains a free cell.
    """
    space = free_space(apartment)
    local = frame.to_local(space.centers)
    for rectangle in rectangles:
        inside = rectangle.contains(local) & (space.island == 0)
        if inside.any():
            return _draw(space.centers[inside], point, rng)
    raise PerdureError(f"{apartment.name}: no free cell in front of the furniture at {frame}")


def stand_anywhere(apartment: Apartment, opened: Mapping[str, float], rng: np.random.Generator) -> Pose:
    """Draw a cell of the largest island and a heading, both uniformly."""
    space = free_space(apartment, opened)
    x, y = _cell(space.centers[space.island == 0], rng)
    return Pose(x, y, 2.0 * np.pi * float(rng.random()))


@lru_cache(maxsize=4096)
def _cells_near(apartment: Apartment, point: tuple[float, float], front: tuple[float, float] | None) -> FloatArray:
    """Return the centers of allowed cells. Shape (m, 2)."""
    space = free_space(apartment)
    away = np.hypot(*(space.centers - point).T)
    inside = (space.island == 0) & (away <= NEAR)
    if front is not None:
        inside &= (space.centers - point) @ np.asarray(front) >= IN_FRONT * away
    cells: FloatArray = space.centers[inside]
    cells.flags.writeable = False
    return cells


def _draw(cells: FloatArray, point: tuple[float, float, float], rng: np.random.Generator) -> Pose:
    x, y = _cell(cells, rng)
    dx, dy = np.clip(rng.normal(0.0, POSITION_NOISE, 2), -POSITION_CLIP, POSITION_CLIP)
    turn = float(np.clip(rng.normal(0.0, HEADING_NOISE), -HEADING_CLIP, HEADING_CLIP))
    x += float(dx)
    y += float(dy)
    return Pose(x, y, float(np.arctan2(point[1] - y, point[0] - x)) + turn)


def _cell(cells: FloatArray, rng: np.random.Generator) -> tuple[float, float]:
    if not len(cells):
        raise PerdureError("the robot has no free cell to begin in")
    x, y = cells[int(rng.integers(len(cells)))]
    return float(x), float(y)


OPEN_RADIUS = 0.8
GROW_BY = 0.1
GROW_TO = 2.0
"""In the open: radius around the point in [m], and the step and limit by which it grows until it contains a cell."""


def reaching_region(link: str) -> Rectangle:
    """Return the region for reaching into an open container, in the frame of `front_frame`.

    Those of drawers and fridge are M3's (`configs/rearrange/tasks/nav_v1*.yaml`, `sub_tasks/nav*.py`), with one
    difference (our choice): for pick and place in the fridge M3 also keeps only cells at least 0.4 m behind the handle
    of the open door. So our robot may stop in front of the door's edge.
    """
    container = container_of(link)
    return Rectangle(container.region_x, container.region_half_width)


@dataclass(frozen=True)
class Aim:
    """What a skill acts on, as navigation needs it."""

    point: tuple[float, float, float]
    """The object, goal or handle that the robot should face, in the room in [m]."""
    link: str | None = None
    """The drawer or door that the skill moves, or that contains the object or goal."""
    rectangle: Rectangle | None = None
    """The region in front of `link`; the one for reaching into it when None."""


def region(apartment: Apartment, opened: Mapping[str, float], aim: Aim) -> tuple[FreeSpace, IntArray]:
    """Return the cells from which a skill can begin, with drawers and doors at the positions `opened` by link name.

    The free space, and indices into its `centers`, never empty: all on the largest island. PerdureError if there is no
    cell within 2 m of a point in the open.
    """
    space = free_space(apartment, opened)
    centers = space.centers
    main = space.island == 0
    if aim.link is None:
        away = np.hypot(*(centers - np.asarray(aim.point)[:2]).T)
        for radius in np.arange(OPEN_RADIUS, GROW_TO + 1e-9, GROW_BY):
            inside = main & (away <= radius)
            if inside.any():
                return space, np.nonzero(inside)[0]
        raise PerdureError(f"no free cell within {GROW_TO} m of {np.round(aim.point, 2).tolist()}")
    box = aim.rectangle or reaching_region(aim.link)
    local = front_frame(apartment, aim.link, opened.get(aim.link, 0.0)).to_local(centers)
    inside = main & box.contains(local)
    if inside.any():
        return space, np.nonzero(inside)[0]
    # M3 would drop such an episode; use the cells nearest to the rectangle.
    outside = np.maximum(np.maximum(box.x[0] - local[:, 0], local[:, 0] - box.x[1]), 0.0)
    miss = np.where(main, outside + np.maximum(np.abs(local[:, 1]) - box.half_width, 0.0), np.inf)
    return space, np.nonzero(miss <= miss.min() + 1e-9)[0]


APART = 0.3
"""Smallest distance in [m] between where two attempts stand, if the region is large enough (our choice)."""


def keep_apart(goal: SkillGoal, stood: Sequence[ArrayLike]) -> SkillGoal:
    """Return the goal of a navigation to a further attempt: the cells of its region away from where others stood."""
    if not len(stood) or goal.route is None:
        return goal
    space = goal.route.space
    cells = np.flatnonzero(goal.route.values == 0.0)
    away = np.linalg.norm(space.centers[cells][:, None] - np.array(stood), axis=2).min(axis=1)
    return replace(goal, route=space.distances(cells[away >= min(APART, away.max())]))


def needed_container(episode: Episode, target: int) -> str:
    """Return the drawer or door that a target begins in; PerdureError when it begins in the open."""
    link = episode.container(target)
    if link is None:
        raise PerdureError(f"target {target} of {episode.name} is not in a drawer or fridge: nothing to open or close")
    return link


def front_of(apartment: Apartment, placement: Placement) -> tuple[float, float]:
    """Return the direction in which a placement's furniture faces, a unit vector in the room."""
    yaw = apartment.piece(apartment.receptacle(placement.receptacle).piece).pose.yaw
    return math.cos(yaw), math.sin(yaw)


def front_frame(apartment: Apartment, link: str, q: float) -> Pose:
    """Return the frame of rectangles in front of a container: at a drawer's handle, at the fridge's center."""
    piece = apartment.piece_of(link).pose
    if not is_drawer(apartment, link):
        return piece
    x, y, _ = handle(apartment, link, q)
    return Pose(x, y, piece.yaw)


def handle(apartment: Apartment, link: str, q: float) -> tuple[float, float, float]:
    """Return the position of a handle in the room in [m] when its link is at `q`."""
    x, y, z = apartment.handle_to_room(link, q)
    return float(x), float(y), float(z)


def is_drawer(apartment: Apartment, link: str) -> bool:
    """Return whether a link slides."""
    return apartment.articulation(link).kind == "slide"


def link_number(apartment: Apartment, link: str) -> int:
    """Return a link's number in `Scene.links`."""
    return [moving.link for moving in apartment.articulations].index(link)


def draw_open(link: str | None, rng: np.random.Generator) -> dict[str, float]:
    """Draw how far a container is open for pick or place (M3's ranges); empty for None."""
    if link is None:
        return {}
    low, high = container_of(link).start_range
    return {link: float(rng.uniform(low, high))}


def open_links(simulator: Simulator) -> dict[str, float]:
    """Return the positions of open drawers and doors in [m] or [rad] by link name.

    Values are rounded to 0.01, so that cached free spaces are found again. Values up to 0.02 count as closed.
    """
    rounded = {link: round(q, 2) for link, q in zip(simulator.scene.links, simulator.links.tolist(), strict=True)}
    return {link: value for link, value in rounded.items() if abs(value) > 0.02}


def carried(episode: Episode, target: int, opened: Mapping[str, float]) -> dict[int, Placement]:
    """Return where a target lies that has moved with its drawer, as `Start.moved`; empty when it has not moved."""
    placement = episode.objects[target]
    link = episode.apartment().receptacle(placement.receptacle).link
    if link is None or link not in opened:
        return {}
    moving = episode.apartment().articulation(link)
    pose = episode.apartment().piece_of(link).pose
    way = (opened[link] - episode.opened.get(link, 0.0)) * np.asarray(moving.axis)
    x, y, z = pose.to_room(pose.to_local(np.asarray(placement.position)) + way)
    return {0: replace(placement, position=(float(x), float(y), float(z)))}


POOL = 64
"""Episodes in a pool: one for each training apartment."""
_MADE_BY = ("sim/*.py", "tasks/*.py", "data/*.json", "data/*.xml")
"""Files that determine the episodes."""
_RECORDERS = ("evaluate/execute.py", "evaluate/plan_starts.py")
_STARTS_BY = (*_MADE_BY, *_RECORDERS, "agents/*.py", "skills/*.py", "../policy/shipped/home/*/*/*.safetensors")
"""Files that determine the recorded start states."""


def train_pool(task: str, count: int = POOL) -> EpisodeSet:
    """Return episodes of the split `train`, `count` of them spread over the apartments.

    A larger pool begins with a smaller one. The first call needs about a second for each episode and reports progress
    on stderr; later calls read a file.

    Raises:
        PerdureError: If `count` is not positive or the task is unknown.
    """
    get_task(task)
    if count < 1:
        raise PerdureError(f"count must be 1 episode or more, not {count}")
    path = cache_folder() / f"{task}_train_{count}_seed0_{fingerprint()}.json"
    if path.exists():
        with suppress(PerdureError):  # damaged: it is made again
            return read_episodes(path)
    # All layouts are among the first few apartments.
    apartments = sorted(split_apartments("train"), key=lambda apartment: (apartment[1], apartment[0]))
    made = []
    for index in range(count):
        made.append(generate_episode(task, "train", index, apartments[index % len(apartments)]))
        if index + 1 in (1, count):
            print(f"making training episodes of {task}: {index + 1} of {count}", file=sys.stderr, flush=True)
    pool = EpisodeSet(task, "train", {"seed": "0", "mujoco": version("mujoco")}, tuple(made))
    path.parent.mkdir(parents=True, exist_ok=True)
    write_episodes(path, pool)
    return pool


def plan_starts_file(task: str) -> Path:
    """Return the file of the recorded start states of a task."""
    return cache_folder() / f"{task}_starts_{fingerprint(_STARTS_BY)}.json"


def read_plan_starts(task: str, skill: str) -> list[PlanStart]:
    """Return the recorded start states of a skill; PerdureError when nothing was recorded."""
    path = plan_starts_file(task)
    if not path.exists():
        raise PerdureError(f"{path} is missing: `perdure home train` or `record_plan_starts({task!r})` makes it")
    return [row for row in read_json(path.read_bytes(), list[PlanStart]) if row.step[0] == skill]


def cache_folder() -> Path:
    """Return the folder of the pools: `$XDG_CACHE_HOME/perdure/episodes`; `~/.cache` where the variable is not set."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "perdure" / "episodes"


@lru_cache(maxsize=2)
def fingerprint(made_by: tuple[str, ...] = _MADE_BY) -> str:
    """Return a digest (12 digits) of files, by default of those that determine generated episodes, and of MuJoCo."""
    digest = hashlib.sha256(version("mujoco").encode())
    for files in made_by:
        for path in sorted(Path(__file__).parents[1].glob(files)):
            digest.update(path.name.encode() + path.read_bytes())
    return digest.hexdigest()[:12]
