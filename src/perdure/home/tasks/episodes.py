"""Episodes: apartment, start poses of the objects and goals of the targets; their files, scenes and robot start poses.

The robot's start pose is not part of an episode: the evaluation seed draws it.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from msgspec import Meta

from perdure.errors import PerdureError, lookup
from perdure.home.sim import occupancy
from perdure.home.sim.apartments import make_apartment
from perdure.home.sim.arrays import FloatArray
from perdure.home.sim.objects import Placement, get_kind
from perdure.home.sim.occupancy import CELL, apartment_footprints, free_space
from perdure.home.sim.pieces import CONTAINERS, Apartment, Pose
from perdure.home.sim.scene import Scene, SceneOptions, build_scene
from perdure.home.tasks.tasks import HomeTask, get_task
from perdure.runs import write_atomic
from perdure.schema import Record, checked, read_json


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

    def __hash__(self) -> int:
        """Of name and objects; episodes are keys wherever something is kept for them."""
        return hash((self.name, self.objects))

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

    def container_links(self) -> dict[str, str | None]:
        """Return the link of every container that its targets are about, by the container's name.

        It is the first one in which a target starts or ends. Where there is none it is the container's only link, and
        None where it has several.
        """
        apartment = self.apartment()
        placements = (*self.objects[: len(self.goals)], *self.goals)
        used = [apartment.container(each.receptacle) for each in placements]
        found: dict[str, str | None] = {}
        for name, container in CONTAINERS.items():
            only = container.links[0] if len(container.links) == 1 else None
            found[name] = next((link for link in used if link in container.links), only)
        return found


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


REST_ARM_BOTTOM = 0.6
"""Furniture that ends below this height in [m] does not meet the arm at rest."""
REST_ARM_LENGTH = (0.10, 0.45)
"""The arm at rest, seen from above: discs along the robot's x between these in [m] (the gripper rests at 0.5 m)."""
REST_ARM_RADIUS = 0.20
"""Radius of these discs in [m]."""


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
    tall = apartment_footprints(apartment, episode.opened, low=REST_ARM_BOTTOM)
    digest = hashlib.sha256(episode.name.encode()).digest()
    rng = np.random.Generator(np.random.PCG64([seed, *digest[:8]]))
    low = np.min(apartment.room, axis=0)
    high = np.max(apartment.room, axis=0)
    while True:
        across, along, turn = rng.random(3)
        point = low + (across, along) * (high - low)
        pose = Pose(float(point[0]), float(point[1]), 2.0 * math.pi * float(turn))
        if not space.is_free(point[None])[0]:
            continue
        discs = pose.to_room(np.stack([np.linspace(*REST_ARM_LENGTH, 8), np.zeros(8)], axis=-1))
        if (
            occupancy.clearance(discs, tall).min() < REST_ARM_RADIUS
            or not occupancy.inside(discs, apartment.room).all()
        ):
            continue
        if space.nearest(point[None])[1][0] <= CELL:
            return pose


@lru_cache(maxsize=512)  # 0.3 MB each: those of 64 training episodes with five targets, or 100 published ones
def episode_scene(episode: Episode, options: SceneOptions = SceneOptions()) -> Scene:  # noqa: B008 - frozen
    """Return the scene of an episode; the last ones asked for are kept and handed out again."""
    count = len(episode.goals)
    wanted = range(count) if options.targets is None else options.targets
    placements = [episode.objects[k] for k in wanted]
    if options.clutter:
        placements += episode.objects[count:]
    return build_scene(episode.apartment(), placements, episode.opened, options)


DATA = Path(__file__).parents[1] / "data" / "episodes"
"""Where the published episodes are."""
PUBLISHED = ("val", "eval", "eval-2")
"""The splits that are published; training draws its own episodes."""


def episode_file(task: str, split: str) -> str:
    """Return the name of the file of published episodes."""
    return f"{task}_{split}.json"


def published_splits(task: str) -> tuple[str, ...]:
    """Return the splits of a task that are published: none for a task whose episodes are yet to be made."""
    return tuple(split for split in PUBLISHED if (DATA / episode_file(task, split)).exists())


@cache
def load_episodes(task: str, split: str) -> EpisodeSet:
    """Return the published episodes of a task (`tidy_house`, ...) and a split (`val`, ...), read once in a process.

    Raises:
        PerdureError: If there is no such task, or no episodes of that split are published.
    """
    get_task(task)
    published = published_splits(task)
    if not published:
        raise PerdureError(
            f"no episodes of {task} are published, so there is no split {split!r}: tools/publish_episodes.py in "
            "perdure's repository makes them"
        )
    lookup(dict.fromkeys(published), split, f"published split of {task}")
    return read_episodes(DATA / episode_file(task, split))


def read_episodes(path: str | Path) -> EpisodeSet:
    """Return the episodes in a file.

    Raises:
        PerdureError: With the file's name, when it is not one of episodes, damaged, edited or of another version.
    """
    try:
        data = read_json(Path(path).read_bytes(), dict[str, Any])
        content = checked(data, Content)
        if data.pop("sha256") != _digest(data):
            raise PerdureError("it is damaged or was edited: its content does not match its sha256")
        return _from_json(content)
    except (OSError, ValueError) as error:
        raise PerdureError(f"{path} cannot be read as a file of episodes: {error}") from error


def write_episodes(path: str | Path, episodes: EpisodeSet) -> None:
    """Write a file of episodes, whole or not at all."""
    content = _to_json(episodes)
    lines = ",\n".join(json.dumps(row, separators=(",", ":")) for row in content["episodes"])
    head = json.dumps({k: v for k, v in content.items() if k != "episodes"} | {"sha256": _digest(content)}, indent=1)
    write_atomic(path, f'{head[:-2]},\n "episodes": [\n{lines}\n]}}\n')


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
    """A file."""

    schema: Literal["perdure.home.episodes"]
    version: Literal[1]
    sha256: str
    """Of everything else."""
    task: str
    split: Annotated[str, Meta(min_length=1, max_length=50)]
    made_with: dict[str, str]
    kinds: list[str]
    receptacles: list[str]
    episodes: Annotated[list[EpisodeRow], Meta(min_length=1)]

    def __post_init__(self) -> None:
        """Refuse unknown kinds, and rows that name what is not in the file."""
        for kind in self.kinds:
            get_kind(kind)
        rows = [row for episode in self.episodes for row in (*episode.objects, *episode.goals)]
        if any(row[0] >= len(self.kinds) or row[8] >= len(self.receptacles) for row in rows):
            raise ValueError("a placement has a kind or a receptacle that is not in the file's lists")


def _digest(content: dict[str, Any]) -> str:
    """Return the SHA-256 of the content; ValueError where it holds nan."""
    text = json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


def _to_json(episodes: EpisodeSet) -> dict[str, Any]:
    """Return JSON values: names once, and each object as [kind, x, y, z, qw, qx, qy, qz, receptacle]."""
    everything = [p for e in episodes.episodes for p in (*e.objects, *e.goals)]
    kinds = sorted({p.kind for p in everything})
    receptacles = sorted({p.receptacle for p in everything})

    def rows(placements: Sequence[Placement]) -> list[list[float]]:
        return [[kinds.index(p.kind), *p.position, *p.quaternion, receptacles.index(p.receptacle)] for p in placements]

    return {
        "schema": "perdure.home.episodes",
        "version": 1,
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

    episodes = []
    for row in content.episodes:
        macro, micro, fingerprint = row.apartment
        objects = placements(row.objects)
        goals = placements(row.goals)
        episodes.append(
            Episode(content.task, content.split, row.index, macro, micro, fingerprint, row.opened, objects, goals)
        )
    return EpisodeSet(content.task, content.split, content.made_with, tuple(episodes))
