"""A part of a protocol that is run and kept as a whole, in this process or in another one."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any, Self

from perdure.home.agents import Actor
from perdure.home.agents.release import HandOver
from perdure.home.benchmark.episodes import load_episodes
from perdure.home.benchmark.tasks import SkillName
from perdure.home.errors import HomeError
from perdure.home.evaluate.execute import Executor
from perdure.home.evaluate.outcomes import UNTRAINED, write_logs
from perdure.home.evaluate.protocol.policies import SkillPolicy, make_actors, read_policy
from perdure.home.evaluate.protocol.protocol import Protocol
from perdure.store import Store

CHUNK = 50
"""Episodes in one unit of the store: what a killed run loses at most (about a minute), and what runs side by side."""
LOGS = "logs.parquet"

Told = Callable[[int], None]
"""Told of every episode that has ended."""


@dataclass(frozen=True)
class Unit:
    """A part of a protocol that is run and kept as a whole."""

    train_seed: int
    eval_seed: int
    first: int
    """Its first episode."""
    last: int
    """Its last episode."""

    def key(self, protocol: Protocol) -> str:
        """Its place in the store."""
        return (
            f"{protocol.folder}/train-{self.train_seed}/eval-{self.eval_seed}/episodes-{self.first:03d}-{self.last:03d}"
        )


def units(protocol: Protocol) -> Iterator[Unit]:
    """All parts of a protocol, evaluation seeds before training seeds, so that an early look sees every policy."""
    for eval_seed in range(protocol.eval_seeds):
        for train_seed in range(protocol.train_seeds):
            for first in range(0, protocol.episodes, CHUNK):
                yield Unit(train_seed, eval_seed, first, min(first + CHUNK, protocol.episodes) - 1)


@dataclass(frozen=True)
class Job:
    """Everything that running one unit takes."""

    protocol: Protocol
    unit: Unit
    policies: Mapping[SkillName, SkillPolicy]
    out: str | Path
    command: str

    @property
    def key(self) -> str:
        """Its place in the store."""
        return self.unit.key(self.protocol)

    @property
    def config(self) -> dict[str, Any]:
        """What the unit is: everything its logs depend on."""
        protocol, unit, options = self.protocol, self.unit, self.protocol.options
        return {
            "task": protocol.task,
            "split": protocol.split,
            "place": protocol.place,
            "train_seed": unit.train_seed,
            "eval_seed": unit.eval_seed,
            "episodes": [unit.first, unit.last],
            "policies": {skill: each.sha256 or each.source for skill, each in self.policies.items()},
            "jaws": options.jaws,
            "physics_hz": options.scene.physics_hz,
            "rolling": options.scene.rolling,
            "apple": options.scene.apple,
            "release_velocity": options.scene.release_velocity,
            "settle_steps": options.settle_steps,
            "mujoco": version("mujoco"),
            "perdure": version("perdure"),
        }

    @property
    def notes(self) -> dict[str, str]:
        """What the logs say about who acted."""
        trained = str(self.unit.train_seed) if any(each.policy for each in self.policies.values()) else str(UNTRAINED)
        names = {skill: each.name for skill, each in self.policies.items()}
        return {
            "arm": self.protocol.name,
            "train_seed": trained,
            "policies": json.dumps(names),
            "command": self.command,
        }

    def on_one_core(self) -> Job:
        """The same work, for one process among several."""
        return replace(self, protocol=replace(self.protocol, options=replace(self.protocol.options, threads=1)))

    def run(self, told: Told) -> None:
        """Runs the unit and keeps its logs; tells 1 whenever an episode has ended."""
        protocol, unit = self.protocol, self.unit
        actors = make_actors(self.policies, protocol.placing.arm)
        executor = Executor(protocol.skills(), actors, replace(protocol.options, eval_seed=unit.eval_seed))
        episodes = load_episodes(protocol.task, protocol.split).episodes[unit.first : unit.last + 1]
        logs = []
        for log in executor.run(episodes):
            logs.append(log)
            told(1)
        logs.sort(key=lambda log: log.episode.index)
        with Store(self.out).write(self.key, self.config) as folder:
            write_logs(folder / LOGS, logs, {**self.notes, **_hand_overs(actors["place"])})

    def to_json(self) -> dict[str, Any]:
        """For another process, see `from_json`."""
        return {
            "protocol": self.protocol.to_json(),
            "unit": asdict(self.unit),
            "policies": {skill: each.source for skill, each in self.policies.items()},
            "out": str(self.out),
            "command": self.command,
            "config": self.config,
        }

    @classmethod
    def from_json(cls, settings: Mapping[str, Any]) -> Self:
        """The job that `to_json` described, its policies read anew.

        Raises:
            HomeError: If a policy is another one by now.
        """
        protocol, unit = Protocol.from_json(settings["protocol"]), Unit(**settings["unit"])
        policies = {skill: read_policy(source) for skill, source in settings["policies"].items()}
        job = cls(protocol, unit, policies, settings["out"], settings["command"])
        for skill, known in settings["config"]["policies"].items():
            if job.config["policies"][skill] != known:
                raise HomeError(f"{policies[skill].source} has changed since this run began")
        return job


def _hand_overs(place: Actor) -> dict[str, str]:
    """What the logs note of the release strategy: how often each outcome came, nothing for the policy alone."""
    return {"hand_overs": json.dumps(Counter(place.outcomes))} if isinstance(place, HandOver) else {}
