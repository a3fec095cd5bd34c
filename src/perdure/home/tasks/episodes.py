"""An episode as data: the apartment, the objects' start poses, and the targets' goals.

The robot's start pose is not part of it: the evaluation seed draws it, see `start.py`.

A file that was damaged or edited is refused by its name.

The rules are those of habitat-lab's generator (`habitat/datasets/rearrange/rearrange_generator.py`) with M3's
configurations: receptacles of targets and goals are drawn first; then objects are placed, targets before clutter, each
uniform on a receptacle drawn uniformly among those allowed, upright with a random heading; then everything settles for
5 s, and an episode in which anything moved by more than 0.1 m is thrown away; then goals are drawn, free of every
object, and an episode with a goal closer than 0.5 m to its object's start is thrown away. Targets and goals lie within
1.5 m of where the robot can stand.

Two additions (OURS): in TidyHouse too the robot must be able to stand near, and no goal overlaps another.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, Protocol

import numpy as np
from msgspec import Meta

from perdure.errors import PerdureError
from perdure.home.sim import occupancy
from perdure.home.sim.apartments import build_apartment, make_apartment, split_apartments
from perdure.home.sim.arrays import FloatArray, Vec3
from perdure.home.sim.objects import KINDS, Placement
from perdure.home.sim.occupancy import CELL, FreeSpace, apartment_footprints, free_space
from perdure.home.sim.pieces import Apartment, Pose, Receptacle
from perdure.home.sim.scene import Scene, SceneOptions, build_scene
from perdure.home.tasks.tasks import TASKS, HomeTask, PlacementRule, get_task
from perdure.runs import write_atomic
from perdure.schema import Choice, Record, checked, read_json


@dataclass(frozen=True)
class Episode:
    """One start of one task in one apartment."""

    task: str
    split: str
    index: int
    """Position in its split, from 0."""
    macro: int
    micro: int
    apartment_fingerprint: str
    opened: Mapping[str, float]
    """Joint positions at the start by link name; everything else is closed."""
    objects: tuple[Placement, ...]
    """The targets first, in the task's order, then the clutter."""
    goals: tuple[Placement, ...]
    """Goal of each target; only the positions count."""

    def __post_init__(self) -> None:
        """Raise PerdureError for an episode that does not fit its task."""
        task = get_task(self.task)
        count = len(task.targets) + sum(number for number, _ in task.clutter)
        if len(self.goals) != len(task.targets) or len(self.objects) != count:
            raise PerdureError(
                f"{self.name} has {len(self.objects)} objects and {len(self.goals)} goals; "
                f"{self.task} has {count} and {len(task.targets)}"
            )
        for target, goal in zip(self.objects, self.goals, strict=False):
            if target.kind != goal.kind:
                raise PerdureError(f"{self.name} has a goal for {goal.kind} where its target is {target.kind}")

    @property
    def name(self) -> str:
        """Such as `set_table/val/003`."""
        return f"{self.task}/{self.split}/{self.index:03d}"

    @property
    def home_task(self) -> HomeTask:
        """The task it belongs to."""
        return get_task(self.task)

    @property
    def goal_positions(self) -> FloatArray:
        """Goals of the targets in [m]. Shape (targets, 3)."""
        return np.array([goal.position for goal in self.goals])

    def apartment(self) -> Apartment:
        """Return the apartment it plays in; PerdureError when this version of the package builds another one."""
        apartment = make_apartment(self.macro, self.micro)
        if apartment.fingerprint != self.apartment_fingerprint:
            raise PerdureError(
                f"{self.name} was made for apartment {apartment.name} {self.apartment_fingerprint}, "
                f"but this version builds {apartment.fingerprint}: its furniture stands elsewhere"
            )
        return apartment

    def container(self, target: int) -> str | None:
        """Return the drawer or door one must open to get at a target: a link name, None when it lies in the open."""
        return self.apartment().container(self.objects[target].receptacle)


@dataclass(frozen=True)
class EpisodeSet:
    """All episodes of one task and split."""

    task: str
    split: str
    made_with: Mapping[str, str]
    """Provenance: seed, package versions."""
    episodes: tuple[Episode, ...]

    def __len__(self) -> int:
        """Number of episodes."""
        return len(self.episodes)

    def __getitem__(self, index: int) -> Episode:
        """The episode at a position; PerdureError beyond the last one."""
        if not 0 <= index < len(self.episodes):
            raise PerdureError(f"{self.task} {self.split} has episodes 0 to {len(self) - 1}, not {index}")
        return self.episodes[index]


def episode_hash(episode: Episode) -> str:
    """Return the SHA-256 of an episode's apartment, starts and goals, in hexadecimal."""
    places = [[p.kind, p.position, p.quaternion, p.receptacle] for p in (*episode.objects, *episode.goals)]
    content = [episode.task, episode.apartment_fingerprint, dict(episode.opened), places]
    return hashlib.sha256(json.dumps(content, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


MAX_CACHED = 512
"""Scenes, 0.3 MB each: those of 64 training episodes with five targets, or 100 published ones."""


def episode_scene(episode: Episode, options: SceneOptions | None = None) -> Scene:
    """Return the scene of an episode; the last ones asked for are kept and handed out again."""
    return _episode_scene(_Key(episode, options or SceneOptions()))


class _Key:
    """An episode is not hashable (its joint positions are a dictionary); its name and its content are."""

    def __init__(self, episode: Episode, options: SceneOptions) -> None:
        self.episode, self.options = episode, options
        self.identity = (episode.name, episode.objects, tuple(sorted(episode.opened.items())), options)

    def __hash__(self) -> int:
        return hash(self.identity)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Key) and self.identity == other.identity


@lru_cache(maxsize=MAX_CACHED)
def _episode_scene(key: _Key) -> Scene:
    episode, options = key.episode, key.options
    count = len(episode.goals)
    wanted = range(count) if options.targets is None else options.targets
    placements = [episode.objects[k] for k in wanted]
    if options.clutter:
        placements += episode.objects[count:]
    return build_scene(episode.apartment(), placements, episode.opened, options)


VERSION = 1
Index = Annotated[int, Meta(ge=0, le=10_000)]
"""Of a kind, a receptacle or an episode in one file."""
Coordinate = Annotated[float, Meta(ge=-100.0, le=100.0)]
"""In a room, in [m]."""
Part = Annotated[float, Meta(ge=-1.001, le=1.001)]
"""Of a unit quaternion."""
PlacementRow = tuple[Index, Coordinate, Coordinate, Coordinate, Part, Part, Part, Part, Index]
"""Kind, x, y, z, qw, qx, qy, qz, receptacle."""


class EpisodeRow(Record, frozen=True):
    """One episode."""

    index: Index
    apartment: tuple[int, int, str]
    """Macro and micro variant, and the fingerprint of the layout."""
    opened: dict[str, Annotated[float, Meta(ge=-10.0, le=10.0)]]
    objects: list[PlacementRow]
    goals: list[PlacementRow]


class Content(Record, frozen=True):
    """A file, without its SHA-256."""

    schema: str
    version: int
    task: str
    split: Annotated[str, Meta(min_length=1, max_length=50)]
    made_with: dict[str, str]
    kinds: list[str]
    receptacles: list[str]
    episodes: Annotated[list[EpisodeRow], Meta(min_length=1)]

    def __post_init__(self) -> None:
        """Refuse unknown names, and rows that name what is not in the file."""
        Choice(tuple(TASKS)).check(self.task, "task")
        for kind in self.kinds:
            Choice(tuple(KINDS)).check(kind, "kinds")
        for episode in self.episodes:
            for row in (*episode.objects, *episode.goals):
                if abs(math.hypot(*row[4:8]) - 1.0) > 1e-3:
                    raise ValueError(f"a placement's orientation must be a unit quaternion, not {row[4:8]}")
                if row[0] >= len(self.kinds) or row[8] >= len(self.receptacles):
                    raise ValueError("a placement has a kind or a receptacle that is not in the file's lists")


SCHEMA = "perdure.home.episodes"
DATA = Path(__file__).parents[1] / "data" / "episodes"
"""Where the published episodes are."""


def load_episodes(task: str, split: str) -> EpisodeSet:
    """Return the published episodes of a task (`tidy_house`, ...) and a split (`val`, `eval`).

    Raises:
        PerdureError: If there is no such task, or no episodes of that split are published.
    """
    get_task(task)
    published = sorted((p.stem.removeprefix(f"{task}_") for p in DATA.glob(f"{task}_*.json")), reverse=True)
    if split not in published:
        raise PerdureError(f"split must be one of {', '.join(published)}, not {split!r}")
    return read_episodes(DATA / f"{task}_{split}.json")


def read_episodes(path: str | Path) -> EpisodeSet:
    """Return the episodes in a file.

    Raises:
        PerdureError: With the file's name, when it is not one of episodes, damaged, edited or of another version.
    """
    path = Path(path)
    if not path.is_file():
        raise PerdureError(
            f"{path} cannot be read as a file of episodes: it {'is no file' if path.exists() else 'is missing'}"
        )
    try:
        content = read_json(path.read_bytes())
    except (OSError, PerdureError) as error:
        raise PerdureError(f"{path} cannot be read as a file of episodes: {error}") from error
    if not isinstance(content, dict) or content.get("schema") != SCHEMA:
        raise PerdureError(f"{path} is not a file of episodes: its schema is not {SCHEMA!r}")
    if content.get("version") != VERSION:
        raise PerdureError(
            f"{path} has version {str(content.get('version'))[:20]}; this package reads version {VERSION}"
        )
    if content.pop("sha256", None) != _digest(content):
        raise PerdureError(f"{path} is damaged or was edited: its content does not match its sha256")
    try:
        return _from_json(checked(content, Content))
    except PerdureError as error:
        raise PerdureError(f"{path} does not hold what a file of episodes must hold: {error}") from error


def write_episodes(path: str | Path, episodes: EpisodeSet) -> None:
    """Write a file of episodes, whole or not at all."""
    content = _to_json(episodes)
    lines = ",\n".join(json.dumps(row, separators=(",", ":")) for row in content["episodes"])
    head = json.dumps({k: v for k, v in content.items() if k != "episodes"} | {"sha256": _digest(content)}, indent=1)
    write_atomic(path, f'{head[:-2]},\n "episodes": [\n{lines}\n]}}\n')


def _digest(content: dict[str, Any]) -> str:
    """Return the SHA-256 of the content; "" where it holds nan or is nested too deep, which no file of ours is."""
    try:
        text = json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False)
    except (ValueError, RecursionError):
        return ""
    return hashlib.sha256(text.encode()).hexdigest()


def _to_json(episodes: EpisodeSet) -> dict[str, Any]:
    """Return JSON values: names once, and each object as [kind, x, y, z, qw, qx, qy, qz, receptacle]."""
    everything = [p for e in episodes.episodes for p in (*e.objects, *e.goals)]
    kinds = sorted({p.kind for p in everything})
    receptacles = sorted({p.receptacle for p in everything})

    def rows(placements: Sequence[Placement]) -> list[list[float]]:
        return [[kinds.index(p.kind), *p.position, *p.quaternion, receptacles.index(p.receptacle)] for p in placements]

    return {
        "schema": SCHEMA,
        "version": VERSION,
        "task": episodes.task,
        "split": episodes.split,
        "made_with": dict(episodes.made_with),
        "kinds": kinds,
        "receptacles": receptacles,
        "episodes": [
            {
                "index": e.index,
                "apartment": [e.macro, e.micro, e.apartment_fingerprint],
                "opened": dict(e.opened),
                "objects": rows(e.objects),
                "goals": rows(e.goals),
            }
            for e in episodes.episodes
        ],
    }


def _from_json(content: Content) -> EpisodeSet:
    def placements(rows: Sequence[PlacementRow]) -> tuple[Placement, ...]:
        return tuple(
            Placement(content.kinds[kind], (x, y, z), (qw, qx, qy, qz), content.receptacles[receptacle])
            for kind, x, y, z, qw, qx, qy, qz, receptacle in rows
        )

    episodes = tuple(
        Episode(
            task=content.task,
            split=content.split,
            index=row.index,
            macro=row.apartment[0],
            micro=row.apartment[1],
            apartment_fingerprint=row.apartment[2],
            opened=row.opened,
            objects=placements(row.objects),
            goals=placements(row.goals),
        )
        for row in content.episodes
    )
    return EpisodeSet(content.task, content.split, content.made_with, episodes)


ARM_LOW = 0.6
"""Furniture that ends below this height in [m] does not meet the arm at rest."""
ARM_FROM, ARM_TO, ARM_RADIUS = 0.10, 0.45, 0.20
"""The arm at rest, seen from above: discs along the robot's x from 0.10 to 0.45 m (the gripper rests at 0.5 m)."""


def start_pose(apartment: Apartment, episode: Episode, seed: int) -> Pose:
    """Return the robot's start pose: uniform over the largest island and headings, the resting arm free of furniture.

    `apartment` is the episode's; the same evaluation seed gives the same pose. PerdureError for a negative seed or
    another episode's apartment.
    """
    if seed < 0:
        raise PerdureError(f"an evaluation seed is 0 or more, not {seed}")
    if apartment.fingerprint != episode.apartment_fingerprint:
        raise PerdureError(f"{episode.name} does not play in {apartment.name} {apartment.fingerprint}")
    space = free_space(apartment, episode.opened)
    tall = apartment_footprints(apartment, episode.opened, low=ARM_LOW)
    digest = hashlib.sha256(episode.name.encode()).digest()
    rng = np.random.Generator(np.random.PCG64([seed, *digest[:8]]))
    low, high = np.min(apartment.room, axis=0), np.max(apartment.room, axis=0)
    while True:
        across, along, turn = rng.random(3)
        point = low + (across, along) * (high - low)
        pose = Pose(float(point[0]), float(point[1]), 2.0 * math.pi * float(turn))
        if not space.is_free(point[None])[0]:
            continue
        discs = pose.to_room(np.stack([np.linspace(ARM_FROM, ARM_TO, 8), np.zeros(8)], axis=-1))
        if occupancy.clearance(discs, tall).min() < ARM_RADIUS or not occupancy.inside(discs, apartment.room).all():
            continue
        if space.nearest(point[None])[1][0] <= CELL:
            return pose


TRIES = 50
"""Places tried for one object on one receptacle (habitat-lab, `samplers/object_sampler.py`)."""
NAVIGABLE_WITHIN = 1.5
"""Largest horizontal distance in [m] from an object or goal to where the robot can stand (`nav_to_min_distance`)."""
GAP = 0.005
"""Smallest gap between two objects on a receptacle in [m] (OURS)."""
LIFT = 0.001
"""Height above the surface at which an object is put before it settles in [m] (OURS)."""


class ObjectModels(Protocol):
    """What the generator needs of the objects. An object's frame: z up when it stands upright."""

    def box(self, kind: str) -> tuple[Vec3, Vec3]:
        """Return lower and upper corner of an upright object's bounding box in its own frame, in [m]."""

    def add(self, spec: Any, kind: str, name: str, position: Vec3, quaternion: tuple[float, ...]) -> None:
        """Add the object as a free body `name` to a MuJoCo specification, its frame at a pose (w, x, y, z)."""


@dataclass
class Surfaces:
    """Objects placed on receptacles so far: footprints (x, y, half x, half y, yaw) by the receptacle's unique name."""

    apartment: Apartment
    space: FreeSpace
    models: ObjectModels
    taken: dict[str, list[FloatArray]] = field(default_factory=dict)

    def footprint(self, kind: str, x: float, y: float, yaw: float) -> FloatArray:
        """Return the rectangle an upright object covers in the room. Shape (5,)."""
        low, high = (np.array(corner) for corner in self.models.box(kind))
        middle, half = 0.5 * (low + high), 0.5 * (high - low)
        cos, sin = math.cos(yaw), math.sin(yaw)
        center = (x + cos * middle[0] - sin * middle[1], y + sin * middle[0] + cos * middle[1])
        return np.array([*center, half[0], half[1], yaw])

    def add(self, placement: Placement) -> None:
        """Add an object to its receptacle."""
        w, _, _, z = placement.quaternion
        shape = self.footprint(placement.kind, *placement.position[:2], 2.0 * math.atan2(z, w))
        self.taken.setdefault(placement.receptacle, []).append(shape)

    def draw(
        self,
        kind: str,
        receptacle: Receptacle,
        rng: np.random.Generator,
        ratio: Mapping[str, float],
        lift: float = LIFT,
        anywhere: bool = False,
    ) -> Placement | None:
        """Return a place for an upright object, uniform on a receptacle, None when none was found in 50 tries.

        Args:
            kind: YCB name.
            receptacle: Where to put it.
            rng: The random generator.
            ratio: Share of the receptacle's length and width to use, by receptacle name.
            lift: Distance of its lowest point from the surface in [m].
            anywhere: Whether the robot need not be able to stand near it.
        """
        low, high = self.models.box(kind)
        if high[2] - low[2] + lift >= receptacle.headroom:
            return None
        share = ratio.get(receptacle.name, 1.0)
        for _ in range(TRIES):
            across, along, turn = rng.random(3)
            offset = share * np.array([2.0 * across - 1.0, 2.0 * along - 1.0]) * receptacle.half
            yaw = 2.0 * math.pi * turn
            x, y, height = self.apartment.surface_to_room(receptacle, offset)
            shape = self.footprint(kind, float(x), float(y), yaw)
            if self._is_taken(shape, receptacle) or not (anywhere or self._is_near(x, y)):
                continue
            position = (round(float(x), 4), round(float(y), 4), round(float(height) - low[2] + lift, 4))
            quaternion = (round(math.cos(yaw / 2), 5), 0.0, 0.0, round(math.sin(yaw / 2), 5))
            return Placement(kind, position, quaternion, receptacle.unique_name)
        return None

    def _is_taken(self, shape: FloatArray, receptacle: Receptacle) -> bool:
        others = self.taken.get(receptacle.unique_name, [])
        return bool(others) and bool(occupancy.overlap(shape[None], np.stack(others), GAP).any())

    def _is_near(self, x: float, y: float) -> bool:
        return bool(self.space.nearest(np.array([[x, y]]))[1][0] < NAVIGABLE_WITHIN)


SECONDS = 5.0
"""Time to settle in [s] (habitat-lab, `rearrange_generator.py`)."""
MOVED = 0.1
"""An object that moved farther than this in [m] was not stable (the same)."""
TIMESTEP = 1.0 / 240.0
"""Physics step in [s]."""


def settle(
    apartment: Apartment,
    opened: dict[str, float],
    placements: Sequence[Placement],
    models: ObjectModels,
    seconds: float = SECONDS,
) -> tuple[tuple[Placement, ...], FloatArray, FloatArray]:
    """Simulate objects in an apartment for some seconds.

    Args:
        apartment: Where they are.
        opened: Joint positions of doors and drawers by link name.
        placements: The objects.
        models: How the objects look to MuJoCo.
        seconds: For how long.

    Returns:
        The objects where they came to rest (rounded to 0.1 mm), how far each moved in [m] and how fast it still is in
        [m/s]. Shapes (objects,).
    """
    import mujoco

    spec = build_apartment(apartment, visuals=False)
    spec.option.timestep = TIMESTEP
    names = [f"object_{k}" for k in range(len(placements))]
    for name, placement in zip(names, placements, strict=True):
        models.add(spec, placement.kind, name, placement.position, placement.quaternion)
    model = spec.compile()
    data = mujoco.MjData(model)
    for link, q in opened.items():
        data.joint(apartment.articulation(link).joint).qpos = q
    mujoco.mj_step(model, data, nstep=round(seconds / TIMESTEP))
    mujoco.mj_forward(model, data)
    start = np.array([placement.position for placement in placements])
    bodies = [data.body(name) for name in names]
    moved = np.linalg.norm([body.xpos for body in bodies] - start, axis=1)
    speed = np.linalg.norm([body.cvel[3:] for body in bodies], axis=1)
    rested = (_rested(p, body.xpos, body.xquat) for p, body in zip(placements, bodies, strict=True))
    return tuple(rested), moved, speed


def _rested(placement: Placement, position: FloatArray, quaternion: FloatArray) -> Placement:
    x, y, z = (round(float(value), 4) for value in position)
    q0, q1, q2, q3 = (round(float(value), 5) + 0.0 for value in quaternion)
    return Placement(placement.kind, (x, y, z), (q0, q1, q2, q3), placement.receptacle)


APART = 0.5
"""Smallest distance in [m] from a target's start to its goal."""
PAIRINGS = 100
"""Pairs of object and receptacle tried for one object."""
PER_APARTMENT = {"train": 100, "val": 5, "eval": 5}
"""Episodes in each apartment of a split, as in M3."""
_EPISODES = 1000

Refusal = Callable[[str], None]


def generate_episodes(
    task: str,
    split: str,
    models: ObjectModels,
    seed: int = 0,
    refused: Refusal = lambda reason: None,
    per_apartment: int | None = None,
) -> EpisodeSet:
    """Return all episodes of a task and split (`train`, `val` or `eval`); another seed gives other episodes.

    `refused` is called with the reason whenever a draw is thrown away. `per_apartment`: M3's number when None.
    """
    apartments = split_apartments(split)
    count = PER_APARTMENT[split] if per_apartment is None else per_apartment
    episodes = tuple(
        generate_episode(task, split, number * count + k, apartment, models, seed, refused)
        for number, apartment in enumerate(apartments)
        for k in range(count)
    )
    return EpisodeSet(task, split, {"seed": str(seed)}, episodes)


def generate_episode(
    task: str,
    split: str,
    index: int,
    apartment: tuple[int, int],
    models: ObjectModels,
    seed: int = 0,
    refused: Refusal = lambda reason: None,
) -> Episode:
    """Return one episode in the apartment (macro, micro); it depends on its arguments only, not on other episodes.

    `refused` is called with the reason whenever a draw is thrown away.
    """
    home_task, home = get_task(task), make_apartment(*apartment)
    rng = np.random.Generator(np.random.PCG64([seed, list(TASKS).index(task), *apartment, index]))
    for _ in range(_EPISODES):
        drawn = _draw(home_task, home, models, rng)
        if isinstance(drawn, str):
            refused(drawn)
            continue
        objects, goals = drawn
        opened = dict(home_task.opened)
        return Episode(task, split, index, home.macro, home.micro, home.fingerprint, opened, objects, goals)
    raise PerdureError(f"no episode {index} of {task} in {home.name}: {_EPISODES} draws were thrown away")


def _draw(
    task: HomeTask, apartment: Apartment, models: ObjectModels, rng: np.random.Generator
) -> tuple[tuple[Placement, ...], tuple[Placement, ...]] | str:
    """Return objects and goals, or the reason why this draw is thrown away."""
    space = free_space(apartment, task.opened)
    surfaces = Surfaces(apartment, space, models)
    starts = [_any_of(apartment, target.start, rng) for target in task.targets]
    ends = [_any_of(apartment, target.goal, rng) for target in task.targets]
    objects = _draw_objects(task, surfaces, starts, rng)
    if objects is None:
        return "no room for the objects"
    objects, moved, _ = settle(apartment, dict(task.opened), objects, models)
    if (moved > MOVED).any():
        return "an object was not stable"
    after = Surfaces(apartment, space, models)
    for placement in objects:
        after.add(placement)
    goals = []
    for target, rule, end in zip(objects, task.targets, ends, strict=False):
        goal = after.draw(target.kind, end, rng, rule.goal.ratio, lift=0.0)
        if goal is None:
            return "no room for a goal"
        if np.linalg.norm(np.subtract(goal.position, target.position)) < APART:
            return "a goal is too close to its start"
        after.add(goal)
        goals.append(goal)
    return objects, tuple(goals)


def _draw_objects(
    task: HomeTask, surfaces: Surfaces, starts: Sequence[Receptacle], rng: np.random.Generator
) -> tuple[Placement, ...] | None:
    rules: list[tuple[PlacementRule, Receptacle | None]] = []
    rules += [(target.start, start) for target, start in zip(task.targets, starts, strict=True)]
    rules += [(rule, None) for number, rule in task.clutter for _ in range(number)]
    objects = []
    for rule, fixed in rules:
        placement = _draw_object(surfaces, rule, fixed, rng)
        if placement is None:
            return None
        surfaces.add(placement)
        objects.append(placement)
    return tuple(objects)


def _draw_object(
    surfaces: Surfaces, rule: PlacementRule, fixed: Receptacle | None, rng: np.random.Generator
) -> Placement | None:
    for _ in range(PAIRINGS):
        kind = rule.objects[int(len(rule.objects) * rng.random())]
        receptacle = fixed or _any_of(surfaces.apartment, rule, rng)
        placement = surfaces.draw(kind, receptacle, rng, rule.ratio, anywhere=fixed is None)
        if placement is not None:
            return placement
    return None


def _any_of(apartment: Apartment, rule: PlacementRule, rng: np.random.Generator) -> Receptacle:
    """Return one of the receptacles a rule allows, each instance as likely as any other."""
    candidates = [r for name in rule.receptacles for r in apartment.receptacles_named(name)]
    return candidates[int(len(candidates) * rng.random())]
