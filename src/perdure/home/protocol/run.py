"""The benchmark's protocol: episodes x training seeds x evaluation seeds for one task and one arm, resumable."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from importlib.metadata import version
from pathlib import Path
from typing import Literal, get_args

from perdure.home.episodes import load_episodes
from perdure.home.errors import HomeError
from perdure.home.execute import Executor, ExecutorOptions
from perdure.home.outcomes import UNTRAINED, write_logs
from perdure.home.protocol.naming import arm_name
from perdure.home.protocol.placing import Placing, placing
from perdure.home.protocol.policies import ORACLE, SkillPolicy, choose_policies, make_actors
from perdure.home.protocol.processes import Told, work_through
from perdure.home.skills import Skill, get_skill
from perdure.home.tasks import SkillName, get_task
from perdure.store import Store

CHUNK = 50
"""Episodes in one unit of the store: what a killed run loses at most (about a minute), and what runs side by side."""
LOGS = "logs.parquet"
Vary = Literal["all", "place"]
"""Whose policy is that of the training seed: every skill's, or that of place alone; the others are then of seed 0."""


@dataclass(frozen=True)
class Protocol:
    """What to run."""

    task: str
    place: str = "rl"
    """See `placing`."""
    split: str = "val"
    episodes: int = 100
    train_seeds: int = 1
    eval_seeds: int = 1
    vary: Vary = "all"
    policies: Mapping[str, str] = field(default_factory=dict)
    """See `choose_policies`."""
    options: ExecutorOptions = field(default_factory=ExecutorOptions)

    def __post_init__(self) -> None:
        """Whatever is no task, split, arm or count raises HomeError."""
        count = len(load_episodes(self.task, self.split))
        for name, value, most in (("episodes", self.episodes, count), ("train_seeds", self.train_seeds, None)):
            if value < 1 or (most is not None and value > most):
                raise HomeError(f"{name} must be 1{'' if most is None else f' to {most}'} or more, not {value}")
        if self.eval_seeds < 1:
            raise HomeError(f"eval_seeds must be 1 or more, not {self.eval_seeds}")
        if self.vary not in get_args(Vary):
            raise HomeError(f"vary must be one of {', '.join(get_args(Vary))}, not {self.vary!r}")
        _ = self.placing

    @property
    def placing(self) -> Placing:
        """What `place` means."""
        return placing(self.place)

    @property
    def name(self) -> str:
        """How logs and figures call it, see `arm_name`."""
        return arm_name(self.place, self.options)

    @property
    def folder(self) -> str:
        """Where the store keeps all of it, such as `set_table/val/ik`."""
        return f"{self.task}/{self.split}/{self.name.replace('+', '-plus').replace(' ', '-')}"

    def cast(self, train_seed: int) -> dict[SkillName, SkillPolicy]:
        """What acts in each skill with the policies of a training seed; HomeError as for `choose_policies`."""
        everyone = choose_policies(self.task, 0 if self.vary == "place" else train_seed, self.policies, self.placing)
        if self.vary == "place" and train_seed > 0:
            others: dict[str, str] = {skill: ORACLE for skill in everyone if skill != "place"}
            alone = choose_policies(self.task, train_seed, {**self.policies, **others}, self.placing)
            everyone["place"] = alone["place"]
        return everyone

    def skills(self) -> dict[str, Skill]:
        """The skills of the task's plan."""
        names: set[str] = {step.skill for step in get_task(self.task).skills}
        return {name: get_skill(name, **(self.placing.options if name == "place" else {})) for name in names}


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


def run_protocol(
    protocol: Protocol, out: str | Path, told: Told = lambda episodes: None, command: str = "", processes: int = 1
) -> list[Path]:
    """Runs what is missing of a protocol and hands back the logs of all of it.

    Args:
        protocol: What to run.
        out: Folder of the store. The same call goes on where a killed one stopped.
        told: Called with 1 whenever an episode has ended.
        command: What asked for it; noted in the logs that are written now.
        processes: How many work side by side, each on one core; with 1 this process alone, on the cores of
            `ExecutorOptions.threads`. No result depends on it.

    Raises:
        HomeError: If a policy is missing, before anything is run.
    """
    store, jobs = Store(out), list(_jobs(protocol, out, command))
    missing = [job for job in jobs if not store.done(job.key, job.config)]
    if processes > 1 and len(missing) > 1:
        missing = [job.on_one_core() for job in missing]
    work_through(_run, missing, processes, told)
    return [store.get(job.key, job.config) / LOGS for job in jobs]


@dataclass(frozen=True)
class _Job:
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
    def config(self) -> dict[str, object]:
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

    def on_one_core(self) -> _Job:
        """The same work, for one process among several."""
        return replace(self, protocol=replace(self.protocol, options=replace(self.protocol.options, threads=1)))


def _jobs(protocol: Protocol, out: str | Path, command: str) -> Iterator[_Job]:
    """All units; each training seed's policies are read once."""
    policies = {seed: protocol.cast(seed) for seed in range(protocol.train_seeds)}
    for unit in units(protocol):
        yield _Job(protocol, unit, policies[unit.train_seed], out, command)


def _run(job: _Job, told: Told) -> None:
    """Runs and keeps one unit."""
    protocol, unit = job.protocol, job.unit
    executor = Executor(
        protocol.skills(),
        make_actors(job.policies, protocol.placing.arm),
        replace(protocol.options, eval_seed=unit.eval_seed),
    )
    episodes = load_episodes(protocol.task, protocol.split).episodes[unit.first : unit.last + 1]
    logs = []
    for log in executor.run(episodes):
        logs.append(log)
        told(1)
    logs.sort(key=lambda log: log.episode.index)
    with Store(job.out).write(job.key, job.config) as folder:
        write_logs(folder / LOGS, logs, job.notes)
