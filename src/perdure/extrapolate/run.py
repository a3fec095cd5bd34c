"""A whole evaluation: groups of lanes over the cores, finished groups kept, one table at the end."""

from __future__ import annotations

import hashlib
import os
import queue
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from perdure.envs import make_world
from perdure.extrapolate.errors import ExtrapolationError
from perdure.extrapolate.lanes import FIRST_EVAL_SEED, Extrapolation, LaneSpec, split
from perdure.extrapolate.result import ExtrapolationResult
from perdure.policy import Policy, check_fit, load_policy
from perdure.processes import WorkerError, WorkerProcess
from perdure.store import Store, config_digest

if TYPE_CHECKING:
    import polars as pl

Watcher = Callable[[int, int], None]
"""Called with (lane steps made or no longer needed, lane steps in all)."""


@dataclass(frozen=True)
class _Group:
    lanes: tuple[LaneSpec, ...]
    config: dict[str, Any]

    @property
    def key(self) -> str:
        return f"groups/{config_digest(self.config)[:16]}"


def extrapolate(
    evaluation: Extrapolation,
    out: str | Path,
    *,
    processes: int | None = None,
    command: str = "",
    watch: Watcher = lambda made, total: None,
) -> ExtrapolationResult:
    """Evaluates every lane and writes ``lanes.parquet`` into ``out``.

    Finished groups of lanes are kept in ``out``: an evaluation that was interrupted goes on where it was, and one that
    is repeated with the same number of processes costs nothing. Results do not depend on that number.

    Args:
        evaluation: What is evaluated.
        out: A folder; made if it is missing.
        processes: Worker processes; one for each core by default.
        command: Stored with the table, so that a reader can repeat it.
        watch: Told about progress.

    Raises:
        ExtrapolationError: If the policies do not belong to one task, there is no process, or a worker failed.
        PolicyFileError: If a policy file cannot be read.
        OSError: If ``out`` cannot be written.
    """
    if processes is not None and processes < 1:
        raise ExtrapolationError(f"processes must be at least 1, got {processes}")
    policies = [load_policy(path) for path in evaluation.policies]
    _check(policies)
    Path(out).mkdir(parents=True, exist_ok=True)  # says what is wrong with it before the work begins
    labels = policy_labels(evaluation.policies, policies)
    groups = _plan(evaluation, policies, labels, workers := processes or len(os.sched_getaffinity(0)))
    store = Store(out)
    store.warn_of_other_source(group.key for group in groups)
    progress = _Progress([len(group.lanes) for group in groups], evaluation.steps, watch)

    free: queue.SimpleQueue[int] = queue.SimpleQueue()
    cores = sorted(os.sched_getaffinity(0))
    for place in range(workers):
        free.put(cores[place % len(cores)])

    def work(number: int) -> None:
        if not store.done(groups[number].key):
            core = free.get()
            try:
                _run_worker(groups[number], evaluation, labels, store, core, lambda *now: progress.moved(number, *now))
            finally:
                free.put(core)
        progress.finished(number)

    with ThreadPoolExecutor(workers) as pool:
        for future in [pool.submit(work, number) for number in range(len(groups))]:
            future.result()
    return _collect(store, groups, Path(out), {"command": command})


def policy_labels(paths: Sequence[Path], policies: Sequence[Policy]) -> list[str]:
    """Return a short name for each policy: its method and preset, and what else tells it from the others."""
    labels = [_method_label(policy, path.stem) for path, policy in zip(paths, policies, strict=True)]
    seeds = [policy.provenance.get("seed") for policy in policies]
    by_run = {(label, seed) for label, seed in zip(labels, seeds, strict=True)}
    if len(by_run) == len(labels):
        return labels
    return [f"{label} ({path.parent.name}/{path.stem})" for label, path in zip(labels, paths, strict=True)]


def _method_label(policy: Policy, default: str) -> str:
    method, preset = str(policy.provenance.get("method", default)), policy.provenance.get("preset")
    return f"{method} ({preset})" if preset else method


def _check(policies: Sequence[Policy]) -> None:
    names = sorted({policy.task.name for policy in policies})
    if len(names) > 1:
        raise ExtrapolationError(
            f"all policies of one evaluation must be for one task, these are for {', '.join(names)}"
        )
    world = make_world(names[0], [FIRST_EVAL_SEED])
    try:
        for policy in policies:
            check_fit(policy, world)
    finally:
        world.close()


def _plan(evaluation: Extrapolation, policies: Sequence[Policy], labels: Sequence[str], workers: int) -> list[_Group]:
    lanes = [
        LaneSpec(number, clock, seed)
        for number, policy in enumerate(policies)
        for clock in ((None,) if policy.protocol.embedding is None else evaluation.deployment_clocks(policy.clock))
        for seed in range(evaluation.eval_seeds)
    ]
    if not lanes:
        raise ExtrapolationError("no lane to evaluate: these clocks fit none of the policies")
    digests = [hashlib.sha256(path.read_bytes()).hexdigest() for path in evaluation.policies]
    return [
        _Group(
            tuple(group),
            {
                "steps": evaluation.steps,
                "versions": {name: version(name) for name in ("perdure", "envpool", "gymnasium", "numpy")},
                "lanes": [
                    [digests[lane.policy], labels[lane.policy], _clock_json(lane), lane.eval_seed] for lane in group
                ],
            },
        )
        for group in split(lanes, evaluation.max_lanes, workers)
    ]


def _clock_json(lane: LaneSpec) -> dict[str, Any] | None:
    return None if lane.clock is None else lane.clock.to_json()


def _run_worker(
    group: _Group,
    evaluation: Extrapolation,
    labels: Sequence[str],
    store: Store,
    core: int,
    moved: Callable[[int, int], None],
) -> None:
    job = {
        "policies": [str(path.resolve()) for path in evaluation.policies],
        "labels": list(labels),
        "lanes": [[lane.policy, _clock_json(lane), lane.eval_seed] for lane in group.lanes],
        "steps": evaluation.steps,
        "store": str(store.root),
        "key": group.key,
        "config": group.config,
    }
    with WorkerProcess("perdure.extrapolate.worker", [core]) as worker:
        try:
            for step, living in worker.ask(job):
                moved(step, living)
        except WorkerError as error:
            raise ExtrapolationError(str(error)) from None


class _Progress:
    """Adds up what the groups report. Lanes that have ended need no more steps, and count as done."""

    def __init__(self, lanes: Sequence[int], steps: int, watch: Watcher) -> None:
        self._lanes, self._steps, self._watch = lanes, steps, watch
        self._made = [0] * len(lanes)
        self._lock = threading.Lock()

    def moved(self, group: int, step: int, living: int) -> None:
        ended = self._lanes[group] - living
        self._set(group, step * living + self._steps * ended)

    def finished(self, group: int) -> None:
        self._set(group, self._lanes[group] * self._steps)

    def _set(self, group: int, made: int) -> None:
        with self._lock:
            self._made[group] = made
            self._watch(sum(self._made), sum(self._lanes) * self._steps)


def _collect(store: Store, groups: Sequence[_Group], out: Path, notes: dict[str, str]) -> ExtrapolationResult:
    import polars as pl

    from perdure.extrapolate.worker import TABLE
    from perdure.report import write_table

    frame: pl.DataFrame = pl.concat([pl.read_parquet(store.get(group.key) / TABLE) for group in groups])
    return ExtrapolationResult(frame, write_table(out / TABLE, frame, notes))
