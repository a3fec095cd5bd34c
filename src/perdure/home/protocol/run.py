"""The benchmark's protocol: episodes x training seeds x evaluation seeds for one task and one arm, resumable."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from importlib.metadata import version
from multiprocessing import get_context
from pathlib import Path
from threading import Thread

from perdure.home.arms import ARMS
from perdure.home.episodes import load_episodes
from perdure.home.errors import HomeError
from perdure.home.execute import Executor, ExecutorOptions
from perdure.home.outcomes import UNTRAINED, write_logs
from perdure.home.protocol.policies import SkillPolicy, choose_policies, make_actors
from perdure.home.skills import Skill, get_skill
from perdure.home.tasks import SkillName, get_task
from perdure.store import Store

CHUNK = 10
"""Episodes in one unit of the store: what a killed run loses at most."""
LOGS = "logs.parquet"
_LIBRARIES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
Told = Callable[[int], None]


@dataclass(frozen=True)
class Protocol:
    """What to run."""

    task: str
    place: str = "rl"
    """`rl`, `stop`, `ik`, `ik+`, or `delta-N`: the policy alone, trained to make objects stay for N steps."""
    split: str = "val"
    episodes: int = 100
    train_seeds: int = 1
    eval_seeds: int = 1
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
        _ = self.arm, self.delta

    @property
    def arm(self) -> str:
        """The arm around the policy: `rl` for `delta-N`."""
        if self.place.startswith("delta-"):
            return "rl"
        if self.place not in ARMS:
            raise HomeError(f"place must be one of {', '.join(ARMS)} or delta-N, not {self.place!r}")
        return self.place

    @property
    def delta(self) -> int:
        """For how many steps a placed object must stay before place stops; 1 is the benchmark's rule."""
        text = self.place.removeprefix("delta-")
        if not self.place.startswith("delta-"):
            return 1
        if not text.isdigit() or int(text) < 2:
            raise HomeError(f"the number in delta-N must be 2 or more, not {text!r}")
        return int(text)

    @property
    def name(self) -> str:
        """How logs and figures call it: `place`, and what differs from the usual world, such as `ik jaws-apart`."""
        options = self.options
        unusual = [f"jaws-{options.jaws}"] if options.jaws != "never" else []
        unusual += [options.scene.rolling] if options.scene.rolling != "friction" else []
        return " ".join([self.place, *unusual])

    @property
    def folder(self) -> str:
        """Where the store keeps all of it, such as `set_table/val/ik`."""
        return f"{self.task}/{self.split}/{self.name.replace('+', '-plus').replace(' ', '-')}"

    def skills(self) -> dict[str, Skill]:
        """The skills of the task's plan."""
        names: set[str] = {step.skill for step in get_task(self.task).skills}
        return {name: get_skill(name, **({"delta": self.delta} if name == "place" else {})) for name in names}


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
        told: Called with the number of episodes that were run, as soon as they are kept.
        command: What asked for it; noted in the logs that are written now.
        processes: How many work side by side, each on one core; with 1 this process alone, on the cores of
            `ExecutorOptions.threads`. No result depends on it.
    """
    store, parts = Store(out), list(units(protocol))
    missing = [unit for unit in parts if not store.done(unit.key(protocol), _config(protocol, unit))]
    if processes > 1 and len(missing) > 1:
        alone = replace(protocol, options=replace(protocol.options, threads=1))
        # A forked process would take over this one's threads in whatever state they are.
        count = min(processes, len(missing))
        with (
            _one_thread_each(),
            ProcessPoolExecutor(count, get_context("spawn"), _end_with, (os.getpid(),)) as pool,
        ):
            running = [pool.submit(_run, alone, unit, out, command) for unit in missing]
            try:
                for finished in as_completed(running):
                    told(finished.result())
            finally:
                pool.shutdown(cancel_futures=True)
    else:
        for unit in missing:
            told(_run(protocol, unit, out, command))
    return [store.get(unit.key(protocol), _config(protocol, unit)) / LOGS for unit in parts]


def _run(protocol: Protocol, unit: Unit, out: str | Path, command: str) -> int:
    """Runs and keeps one unit; how many episodes it has."""
    policies = _policies(protocol, unit)
    executor = Executor(
        protocol.skills(),
        make_actors(policies, protocol.arm),
        replace(protocol.options, eval_seed=unit.eval_seed),
    )
    episodes = load_episodes(protocol.task, protocol.split).episodes[unit.first : unit.last + 1]
    logs = sorted(executor.run(episodes), key=lambda log: log.episode.index)
    with Store(out).write(unit.key(protocol), _config(protocol, unit)) as folder:
        write_logs(folder / LOGS, logs, _notes(protocol, unit, policies) | {"command": command})
    return len(logs)


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """Processes begun meanwhile do linear algebra on one thread: together they have the cores already."""
    before = {name: os.environ.get(name) for name in _LIBRARIES}
    os.environ.update(dict.fromkeys(_LIBRARIES, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            os.environ.pop(name) if value is None else os.environ.update({name: value})


def _end_with(parent: int) -> None:
    """In a new process: ends it when its parent is gone, however that ended."""

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(1.0)
        os._exit(1)

    Thread(target=watch, daemon=True).start()


def _policies(protocol: Protocol, unit: Unit) -> dict[SkillName, SkillPolicy]:
    return choose_policies(protocol.task, unit.train_seed, protocol.policies, protocol.delta)


def _notes(protocol: Protocol, unit: Unit, policies: Mapping[SkillName, SkillPolicy]) -> dict[str, str]:
    """What the logs say about who acted."""
    trained = str(unit.train_seed) if any(each.policy for each in policies.values()) else str(UNTRAINED)
    names = {skill: each.name for skill, each in policies.items()}
    return {"arm": protocol.name, "train_seed": trained, "policies": json.dumps(names)}


def _config(protocol: Protocol, unit: Unit) -> dict[str, object]:
    """What a unit is: everything its logs depend on."""
    options, policies = protocol.options, _policies(protocol, unit)
    return {
        "task": protocol.task,
        "split": protocol.split,
        "place": protocol.place,
        "train_seed": unit.train_seed,
        "eval_seed": unit.eval_seed,
        "episodes": [unit.first, unit.last],
        "policies": {skill: each.sha256 or each.source for skill, each in policies.items()},
        "jaws": options.jaws,
        "physics_hz": options.scene.physics_hz,
        "rolling": options.scene.rolling,
        "settle_steps": options.settle_steps,
        "mujoco": version("mujoco"),
        "perdure": version("perdure"),
    }
