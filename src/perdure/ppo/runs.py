"""Training runs: seeds of one task and method, checkpointed, resumed, and turned into policy files."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from perdure.envs import TaskSpec, make_world
from perdure.policy import save_policy
from perdure.ppo.checkpoint import load_checkpoint, save_checkpoint
from perdure.ppo.config import PPOConfig
from perdure.ppo.errors import ConfigError
from perdure.ppo.export import export_policy, write_curves
from perdure.ppo.segment import SegmentRunner
from perdure.ppo.state import SeedState, start_state
from perdure.store import Store, write_whole

CHECKPOINT = "checkpoint.safetensors"
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

    def __post_init__(self) -> None:
        """Refuse a list of seeds that names no run, or one twice."""
        if not self.seeds:
            raise ConfigError("a training run needs at least one seed")
        if min(self.seeds) < 0 or len(set(self.seeds)) < len(self.seeds):
            raise ConfigError(f"seeds must be different numbers from 0 up, got {list(self.seeds)}")

    def key(self, seed: int) -> str:
        """The readable identity of one seed's run."""
        return f"{self.task.replace(':', '_')}/{self.method}/seed-{seed}"

    def identity(self, seed: int) -> dict[str, Any]:
        """Everything the result of one seed depends on."""
        return {"task": self.task, "method": self.method, "seed": seed, "config": self.config.to_json()}


@dataclass(frozen=True)
class Report:
    """What a watcher is told after every iteration."""

    seeds: tuple[int, ...]
    """Seeds that moved."""
    step: int
    """Environment steps each of them has behind it."""
    steps: int
    """Environment steps each of them will have in all."""
    mean_return: float
    """Mean undiscounted return of their last 20 training episodes; nan before the first has ended."""


Watcher = Callable[[Report], None]


def train(
    run: TrainRun, out: str | Path, threads: int | None = None, watch: Watcher = lambda report: None
) -> list[Path]:
    """Trains every seed that is not finished, and returns the policy files in the order of the seeds.

    A run that was interrupted goes on from its last checkpoint; nothing but time depends on that. A seed that is
    finished is not touched.

    Args:
        run: What is trained.
        out: The folder of the store that keeps the runs.
        threads: Cores to use; all of them by default. Results do not depend on it.
        watch: Called after every iteration.

    Raises:
        ConfigError: If the run makes no sense.
        StoreError: If the folder already holds a run of the same name with other settings.
        UnknownTask: If there is no such task.
    """
    if threads is not None and threads < 1:
        raise ConfigError(f"threads must be at least 1, got {threads}")
    store = Store(out)
    spec = _task_spec(run.task)
    with ExitStack() as stack:
        folders = {
            seed: stack.enter_context(store.workspace(run.key(seed), run.identity(seed)))
            for seed in run.seeds
            if not store.done(run.key(seed), run.identity(seed))
        }
        if folders:
            states = [_resume(seed, folder, spec, run.config) for seed, folder in folders.items()]
            runner = SegmentRunner(run.task, run.config, threads or len(os.sched_getaffinity(0)))
            for state in _train_all(runner, states, folders, watch):
                _finish(run, spec, state, folders[state.seed])
    return [store.get(run.key(seed)) / POLICY for seed in run.seeds]


def _task_spec(task: str) -> TaskSpec:
    world = make_world(task, [0])
    spec = world.spec
    world.close()
    return spec


def _resume(seed: int, folder: Path, spec: TaskSpec, config: PPOConfig) -> SeedState:
    checkpoint = folder / CHECKPOINT
    return load_checkpoint(checkpoint) if checkpoint.exists() else start_state(seed, spec, config)


def _train_all(
    runner: SegmentRunner, states: Sequence[SeedState], folders: dict[int, Path], watch: Watcher
) -> list[SeedState]:
    """Carries all seeds to the end. Those furthest behind go first, so that after a kill they meet again."""
    current = {state.seed: state for state in states}
    config = runner.config
    total = config.iterations * config.rollout_size
    while (segment := min(state.segment for state in current.values())) < config.segments:
        group = [state for state in current.values() if state.segment == segment]
        seeds = tuple(state.seed for state in group)
        for state in runner.run(group, partial(_tell, watch, seeds, total)):
            save_checkpoint(state, folders[state.seed] / CHECKPOINT)
            current[state.seed] = state
    return list(current.values())


def _tell(watch: Watcher, seeds: tuple[int, ...], total: int, step: int, mean_return: float) -> None:
    watch(Report(seeds, step, total, mean_return))


def _finish(run: TrainRun, spec: TaskSpec, state: SeedState, folder: Path) -> None:
    """Leaves in the folder what the finished run consists of. May be repeated after a kill."""
    save_policy(export_policy(run, spec, state), folder / POLICY)
    write_curves(state, folder)
    write_whole(folder / "run.json", json.dumps(run.identity(state.seed), indent=1, sort_keys=True) + "\n")
    (folder / CHECKPOINT).unlink(missing_ok=True)
