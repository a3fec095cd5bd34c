"""Training runs: seeds of one task and method, checkpointed, resumed, and turned into policy files."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from perdure.envs import TaskSpec, make_world
from perdure.policy import save_policy
from perdure.ppo.chain import CHECKPOINT, carry_on, reached
from perdure.ppo.checkpoint import load_checkpoint
from perdure.ppo.config import PPOConfig
from perdure.ppo.errors import ConfigError
from perdure.ppo.export import export_policy, write_curves
from perdure.ppo.presets import ZOO
from perdure.ppo.segment import SegmentRunner
from perdure.ppo.spread import Told, carry_all
from perdure.ppo.state import SeedState
from perdure.store import Store, write_whole

POLICY = "policy.safetensors"


@dataclass(frozen=True)
class TrainRun:
    """What is trained. Two runs that are equal give the same files, bit for bit, on the same machine."""

    task: str
    method: str
    """Names the run's folder; the settings are all in ``config``."""
    config: PPOConfig
    seeds: tuple[int, ...] = (0,)
    """Trained side by side; each comes out as if it were trained alone."""
    command: str | None = None
    """What makes it again, `{seed}` standing for the seed; `perdure train ...` when None. Kept in the policy file."""
    preset: str = ZOO
    """Whose hyperparameters `config` began with; names the folder beside the method unless it is the usual one."""

    def __post_init__(self) -> None:
        """Refuse a list of seeds that names no run, or one twice."""
        if not self.seeds:
            raise ConfigError("a training run needs at least one seed")
        if min(self.seeds) < 0 or len(set(self.seeds)) < len(self.seeds):
            raise ConfigError(f"seeds must be different numbers from 0 up, got {list(self.seeds)}")

    def key(self, seed: int) -> str:
        """The readable identity of one seed's run."""
        variant = self.method if self.preset == ZOO else f"{self.method}@{self.preset}"
        return f"{self.task.replace(':', '_')}/{variant}/seed-{seed}"

    def identity(self, seed: int) -> dict[str, Any]:
        """Everything the result of one seed depends on."""
        identity = {"task": self.task, "method": self.method, "seed": seed, "config": self.config.to_json()}
        return identity if self.preset == ZOO else {**identity, "preset": self.preset}


@dataclass(frozen=True)
class Report:
    """What a watcher is told after every iteration."""

    seed: int
    """Who moved."""
    step: int
    """Environment steps it has behind it."""
    steps: int
    """Environment steps it will have in all."""
    mean_return: float
    """Mean undiscounted return of its last 20 training episodes; nan before the first has ended."""
    share: float
    """How much of this call's work is done, all seeds together, from 0 to 1."""


Watcher = Callable[[Report], None]


def train(
    run: TrainRun,
    out: str | Path,
    threads: int | None = None,
    watch: Watcher = lambda report: None,
    processes: int | None = None,
) -> list[Path]:
    """Trains every seed that is not finished, and returns the policy files in the order of the seeds.

    A run that was interrupted goes on from its last checkpoint; nothing but time depends on that. A seed that is
    finished is not touched.

    Args:
        run: What is trained.
        out: The folder of the store that keeps the runs.
        threads: Cores to use; all of them by default. Results do not depend on it.
        watch: Called after every iteration.
        processes: Processes to spread the seeds over, each on cores of its own: faster, also for one seed, but blind to
            environments that only this process has registered (name those "gymnasium:module:Env-v0"). By default this
            process does all the work, one seed after the other. Results do not depend on it.

    Raises:
        ConfigError: If the run makes no sense.
        StoreError: If the folder already holds a run of the same name with other settings.
        UnknownTask: If there is no such task.
        WorkerError: If one of the processes failed.
    """
    for name, value in (("threads", threads), ("processes", processes)):
        if value is not None and value < 1:
            raise ConfigError(f"{name} must be at least 1, got {value}")
    store = Store(out)
    store.warn_of_other_source(run.key(seed) for seed in run.seeds)
    threads = threads or len(os.sched_getaffinity(0))
    spec = _task_spec(run.task)
    with ExitStack() as stack:
        folders = {
            seed: stack.enter_context(store.workspace(run.key(seed), run.identity(seed)))
            for seed in run.seeds
            if not store.done(run.key(seed), run.identity(seed))
        }
        if folders:
            told = _Told(run.config, folders, watch)
            if processes is None:
                _carry_here(run, folders, threads, told)
            else:
                carry_all(run.task, run.config, folders, processes, threads, told)
            for folder in folders.values():
                _finish(run, spec, load_checkpoint(folder / CHECKPOINT), folder)
    return [store.get(run.key(seed)) / POLICY for seed in run.seeds]


def _task_spec(task: str) -> TaskSpec:
    world = make_world(task, [0])
    spec = world.spec
    world.close()
    return spec


def _carry_here(run: TrainRun, folders: Mapping[int, Path], threads: int, told: Told) -> None:
    """Carries all seeds to the end. Those furthest behind go first, so that after a kill they meet again."""
    runner = SegmentRunner(run.task, run.config, threads)
    behind = {seed: reached(folder) for seed, folder in folders.items()}
    while (segment := min(behind.values())) < run.config.segments:
        seed = min(seed for seed in behind if behind[seed] == segment)
        carry_on(runner, seed, folders[seed], partial(told, seed))
        behind[seed] += 1


class _Told:
    """Makes reports of what seeds tell."""

    def __init__(self, config: PPOConfig, folders: Mapping[int, Path], watch: Watcher) -> None:
        self._steps, self._watch = config.iterations * config.rollout_size, watch
        size = config.segment_iterations * config.rollout_size
        self._began = {seed: min(reached(folder) * size, self._steps) for seed, folder in folders.items()}
        self._now = dict(self._began)

    def __call__(self, seed: int, step: int, mean_return: float) -> None:
        self._now[seed] = step
        made = sum(self._now.values()) - sum(self._began.values())
        work = self._steps * len(self._now) - sum(self._began.values())
        self._watch(Report(seed, step, self._steps, mean_return, made / work))


def _finish(run: TrainRun, spec: TaskSpec, state: SeedState, folder: Path) -> None:
    """Leaves in the folder what the finished run consists of. May be repeated after a kill."""
    save_policy(export_policy(run, spec, state), folder / POLICY)
    write_curves(state, folder)
    write_whole(folder / "run.json", json.dumps(run.identity(state.seed), indent=1, sort_keys=True) + "\n")
    (folder / CHECKPOINT).unlink(missing_ok=True)
