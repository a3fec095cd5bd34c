"""An episode as data: the apartment, the objects' start poses, and the targets' goals.

The robot's start pose is not part of it: the evaluation seed draws it, see `start.py`.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from perdure.home.benchmark.tasks import HomeTask, get_task
from perdure.home.errors import HomeError
from perdure.home.sim.apartments import Apartment, make_apartment
from perdure.home.sim.arrays import FloatArray
from perdure.home.sim.objects import Placement


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
        """Raise HomeError for an episode that does not fit its task."""
        task = get_task(self.task)
        count = len(task.targets) + sum(number for number, _ in task.clutter)
        if len(self.goals) != len(task.targets) or len(self.objects) != count:
            raise HomeError(
                f"{self.name} has {len(self.objects)} objects and {len(self.goals)} goals; "
                f"{self.task} has {count} and {len(task.targets)}"
            )
        for target, goal in zip(self.objects, self.goals, strict=False):
            if target.kind != goal.kind:
                raise HomeError(f"{self.name} has a goal for {goal.kind} where its target is {target.kind}")

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
        """Return the apartment it plays in; HomeError when this version of the package builds another one."""
        apartment = make_apartment(self.macro, self.micro)
        if apartment.fingerprint != self.apartment_fingerprint:
            raise HomeError(
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
        """The episode at a position; HomeError beyond the last one."""
        if not 0 <= index < len(self.episodes):
            raise HomeError(f"{self.task} {self.split} has episodes 0 to {len(self) - 1}, not {index}")
        return self.episodes[index]


def episode_hash(episode: Episode) -> str:
    """Return the SHA-256 of an episode's apartment, starts and goals, in hexadecimal."""
    places = [[p.kind, p.position, p.quaternion, p.receptacle] for p in (*episode.objects, *episode.goals)]
    content = [episode.task, episode.apartment_fingerprint, dict(episode.opened), places]
    return hashlib.sha256(json.dumps(content, sort_keys=True, separators=(",", ":")).encode()).hexdigest()
