"""Training runs: seeds of one task and method, checkpointed, resumed, and turned into policy files.

A seed's run is a chain of segments. Each one begins with the checkpoint in the run's folder and leaves the next.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from perdure.envs.checks import MAX_SEED
from perdure.envs.source import source_digest
from perdure.policy import save_policy
from perdure.ppo.checkpoint import load_checkpoint, save_checkpoint
from perdure.ppo.config import PPOConfig
from perdure.ppo.errors import ConfigError
from perdure.ppo.export import export_policy, write_curves
from perdure.ppo.methods import find_method
from perdure.ppo.presets import ZOO
from perdure.ppo.segment import SegmentRunner
from perdure.ppo.state import start_state
from perdure.runs import (
    Observer,
    Status,
    Store,
    Unit,
    Work,
    check_on,
    run_missing,
    write_atomic,
)

POLICY = "policy.safetensors"
CHECKPOINT = "checkpoint.safetensors"
RECORD = "run.json"
"""Written last."""


@dataclass(frozen=True)
class TrainRun:
    """A training run. Equal runs give the same files, bit for bit, on the same machine."""

    task: str
    method: str
    """Names the run's folder; the settings are all in ``config``."""
    config: PPOConfig
    seeds: tuple[int, ...] = (0,)
    """Trained side by side; each gives the same result as if trained alone."""
    command: str | None = None
    """Command that repeats the run, with `{seed}` for the seed; None: `perdure train ...`. Kept in the policy file."""
    preset: str = ZOO
    """Preset of hyperparameters that `config` started from; part of the folder's name unless it is the default."""
    base_method: str | None = None
    """Method that `config` started from, for the recorded command; None: `method`. Results do not depend on it."""

    def __post_init__(self) -> None:
        """Refuse a list of seeds that names no run, or one twice, and an unknown base method."""
        if self.base_method is not None:
            find_method(self.base_method)
        if not self.seeds:
            raise ConfigError("a training run needs at least one seed")
        if min(self.seeds) < 0 or max(self.seeds) > MAX_SEED or len(set(self.seeds)) < len(self.seeds):
            raise ConfigError(f"seeds must be different numbers from 0 to {MAX_SEED:,}, got {list(self.seeds)}")

    def key(self, seed: int) -> str:
        """Return the readable identity of one seed's run."""
        variant = self.method if self.preset == ZOO else f"{self.method}@{self.preset}"
        return f"{self.task.replace(':', '_')}/{variant}/seed-{seed}"

    def identity(self, seed: int) -> dict[str, Any]:
        """Return everything that the result of one seed depends on."""
        identity = {"task": self.task, "method": self.method, "seed": seed, "config": self.config.to_json()}
        identity |= {"preset": self.preset} if self.preset != ZOO else {}
        source = source_digest(self.task)
        return identity | ({"source": source} if source else {})

    def unit(self, seed: int) -> Unit:
        """Return the training of one seed as a unit of work."""
        settings: dict[str, Any] = {"task": self.task, "method": self.method, "config": self.config.to_json()}
        settings |= {"command": self.command, "preset": self.preset, "base_method": self.base_method, "seed": seed}
        steps = float(self.config.iterations * self.config.rollout_size)
        return Unit(
            self.key(seed),
            self.identity(seed),
            "perdure.ppo.training:train_segment",
            settings,
            size=steps,
            cores=self.config.n_envs,
        )


@dataclass(frozen=True)
class Report:
    """Progress report of a training run."""

    seed: int
    """Seed that has made progress."""
    step: int
    """Environment steps it has made."""
    steps: int
    """Environment steps it will have made in all."""
    mean_return: float
    """Mean undiscounted return of its last 20 training episodes; nan before the first has ended."""
    share: float
    """Share of the work that is done, all seeds together, from 0 to 1."""


def train(
    run: TrainRun,
    out: str | Path,
    *,
    cores: int | None = None,
    on: str = "here",
    observe: Observer = lambda status: None,
    waiting: Callable[[], None] = lambda: None,
) -> list[Path]:
    """Train every seed that is not finished and return the policy files in the order of the seeds.

    An interrupted run resumes from its last checkpoint, with the same result. A finished seed is
    not trained again.

    Args:
        run: What is trained.
        out: The folder of the store that keeps the runs.
        cores: Cores to use; all of them by default. Results do not depend on it.
        on: Where seeds are trained: "here", "local", "ray" or "ray:ADDRESS", see `perdure.runs.make_workers`. Results
            do not depend on it.
        observe: Called with the progress of every seed; `on_report` makes an observer of a function of `Report`.
        waiting: Called once, before waiting for seeds that other commands train.

    Raises:
        ConfigError: If the run makes no sense.
        StoreError: If the folder already holds a run of the same name with other settings.
        UnknownTask: If there is no such task.
        RunError: If training a seed failed, or ``cores`` or ``on`` is out of range.
    """
    check_on(on)
    store, units = Store(out), [run.unit(seed) for seed in run.seeds]
    store.warn_of_other_source(unit.key for unit in units)
    run_missing(units, out, on, cores, observe, waiting)
    return [store.get(unit.key) / POLICY for unit in units]


def on_report(run: TrainRun, callback: Callable[[Report], None]) -> Observer:
    """Return an observer that calls `callback` with a `Report` whenever a seed has made progress."""
    last: dict[int, float] = {}

    def observe(status: Status) -> None:
        from perdure.runs.progress import total_share

        for seed in run.seeds:
            progress = status[run.key(seed)]
            if progress.facts and progress.done != last.get(seed):
                last[seed] = progress.done
                mean = progress.facts.get("return", float("nan"))
                callback(Report(seed, int(progress.done), int(progress.total), mean, total_share(status)))

    return observe


def train_segment(
    work: Work,
    *,
    task: str,
    method: str,
    config: Mapping[str, Any],
    command: str | None,
    preset: str,
    seed: int,
    base_method: str | None = None,
) -> bool:
    """Train one seed for one more segment; the function of `TrainRun.unit`.

    Returns:
        Whether that was the last segment: then the policy and its learning curves are in the work folder.
    """
    run = TrainRun(task, method, PPOConfig.from_json(dict(config)), (seed,), command, preset, base_method)
    runner = _runner(task, run.config, work.threads)
    checkpoint, steps = work.folder / CHECKPOINT, run.config.iterations * run.config.rollout_size
    if (work.folder / RECORD).exists():  # an attempt that was interrupted after its last file
        checkpoint.unlink(missing_ok=True)
        return True
    state = start_state(seed, runner.spec, run.config)
    if checkpoint.exists():
        state = load_checkpoint(checkpoint, state)
    if state.segment < run.config.segments:
        state = runner.run(state, lambda step, mean: work.report(step, steps, **{"return": mean}))
        save_checkpoint(state, checkpoint)
    if state.segment < run.config.segments:
        return False
    save_policy(export_policy(run, runner.spec, state), work.folder / POLICY)
    write_curves(state, work.folder)
    write_atomic(work.folder / RECORD, json.dumps(run.identity(seed), indent=1, sort_keys=True) + "\n")
    checkpoint.unlink(missing_ok=True)
    return True


@lru_cache(maxsize=1)
def _runner(task: str, config: PPOConfig, threads: int) -> SegmentRunner:
    """Keep the compiled programs from segment to segment."""
    return SegmentRunner(task, config, threads)
