"""A part of a protocol that is run and kept as a whole."""

from __future__ import annotations

import json
import os
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

from perdure.home.agents import Actor
from perdure.home.agents.release import HandOver
from perdure.home.benchmark.episodes import load_episodes
from perdure.home.benchmark.tasks import SkillName
from perdure.home.errors import HomeError
from perdure.home.evaluate.execute import Executor
from perdure.home.evaluate.outcomes import UNTRAINED, read_logs, write_logs
from perdure.home.evaluate.protocol.policies import SkillPolicy, make_actors, read_policy
from perdure.home.evaluate.protocol.protocol import Protocol
from perdure.runs import Unit, Work

CHUNK = 50
"""Episodes in one part: what a killed run loses at most (about a minute), and what runs side by side."""
LOGS = "logs.parquet"


@dataclass(frozen=True)
class Part:
    """Which episodes, and with which seeds."""

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


def parts(protocol: Protocol) -> Iterator[Part]:
    """All parts of a protocol, evaluation seeds before training seeds, so that an early look sees every policy."""
    for eval_seed in range(protocol.eval_seeds):
        for train_seed in range(protocol.train_seeds):
            for first in range(0, protocol.episodes, CHUNK):
                yield Part(train_seed, eval_seed, first, min(first + CHUNK, protocol.episodes) - 1)


@dataclass(frozen=True)
class Job:
    """Everything that running one part takes."""

    protocol: Protocol
    part: Part
    policies: Mapping[SkillName, SkillPolicy]
    command: str

    @property
    def key(self) -> str:
        """Its place in the store."""
        return self.part.key(self.protocol)

    @property
    def config(self) -> dict[str, Any]:
        """Everything its logs depend on."""
        protocol, part, options = self.protocol, self.part, self.protocol.options
        return {
            "task": protocol.task,
            "split": protocol.split,
            "place": protocol.place,
            "train_seed": part.train_seed,
            "eval_seed": part.eval_seed,
            "episodes": [part.first, part.last],
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
        trained = str(self.part.train_seed) if any(each.policy for each in self.policies.values()) else str(UNTRAINED)
        names = {skill: each.name for skill, each in self.policies.items()}
        return {
            "arm": self.protocol.name,
            "train_seed": trained,
            "policies": json.dumps(names),
            "command": self.command,
        }

    @property
    def unit(self) -> Unit:
        """The unit of work that runs it."""
        arguments = {
            "protocol": self.protocol.to_json(),
            "part": asdict(self.part),
            "policies": {skill: each.source for skill, each in self.policies.items()},
            "digests": self.config["policies"],
            "command": self.command,
        }
        size = float(self.part.last - self.part.first + 1)
        function = "perdure.home.evaluate.protocol.job:run_part"
        return Unit(self.key, self.config, function, arguments, size=size, cores=len(os.sched_getaffinity(0)))


def run_part(
    work: Work,
    *,
    protocol: Mapping[str, Any],
    part: Mapping[str, int],
    policies: Mapping[SkillName, str],
    digests: Mapping[SkillName, str],
    command: str,
) -> None:
    """Run a part of a protocol and leave its logs in the work folder; the function of `Job.unit`.

    Raises:
        HomeError: If a policy is another one by now.
    """
    if _is_written(work.folder / LOGS):
        return
    read = {skill: read_policy(source) for skill, source in policies.items()}
    job = Job(Protocol.from_json(protocol), Part(**part), read, command)
    for skill, known in digests.items():
        if job.config["policies"][skill] != known:
            raise HomeError(f"{policies[skill]} has changed since this run began")
    options = replace(job.protocol.options, eval_seed=job.part.eval_seed, threads=work.threads)
    actors = make_actors(read, job.protocol.placing.arm)
    episodes = load_episodes(job.protocol.task, job.protocol.split).episodes[job.part.first : job.part.last + 1]
    logs = []
    for log in Executor(job.protocol.skills(), actors, options).run(episodes):
        logs.append(log)
        work.report(len(logs), len(episodes))
    logs.sort(key=lambda log: log.episode.index)
    write_logs(work.folder / LOGS, logs, {**job.notes, **_hand_overs(actors["place"])})


def _is_written(path: Path) -> bool:
    """Say whether an attempt that was interrupted between its last two steps has left its logs."""
    try:
        return path.is_file() and bool(read_logs(path))
    except HomeError:
        return False


def _hand_overs(place: Actor) -> dict[str, str]:
    """What the logs note of the release strategy: how often each outcome came, nothing for the policy alone."""
    return {"hand_overs": json.dumps(Counter(place.outcomes))} if isinstance(place, HandOver) else {}
