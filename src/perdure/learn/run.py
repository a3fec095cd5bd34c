"""Training runs: seeds of one task and method, in segments, checkpointed, resumed, and turned into policy files.

A seed's run is a chain of segments. Each one begins with the checkpoint in the run's folder and leaves the next. It
builds its environments from (seed, segment) alone and cuts running episodes as the end of a rollout does, because an
engine's inner state and random generator cannot be saved. So a run that was killed and a run that was not are the same
run. Within a segment, partial checkpoints keep what its environments were sent, see `perdure.learn.partial`. A run
knows no detail of its algorithm, only the interface `Algorithm`.
"""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from perdure.disturbances import check_onsets, parse_disturbances
from perdure.envs import make_world, task_spec
from perdure.envs.disturbances import DisturbedWorld, disturbed_task
from perdure.envs.suites import is_contract, task_source_digest
from perdure.envs.traced import WorldSlot
from perdure.envs.world import MAX_SEED
from perdure.errors import PerdureError, warn
from perdure.learn.algorithm import Algorithm, Configuration, Stage, algorithm_of
from perdure.learn.checkpoint import RunState, checkpoint_place, load_checkpoint, save_checkpoint
from perdure.learn.first_rollout import say_advice
from perdure.learn.partial import Recorder, ReplayError
from perdure.learn.progress import DIAGNOSTICS
from perdure.learn.provenance import UNNAMED_PRESETS, export_policy
from perdure.learn.start import start_file
from perdure.policy import Policy, find_policy, load_policy, save_policy
from perdure.runs import (
    Observer,
    Status,
    Store,
    Unit,
    Work,
    check_on,
    file_digest,
    run_missing,
    write_atomic,
)
from perdure.runs.progress import Lines
from perdure.schema import parquet_bytes

POLICY = "policy.safetensors"
"""Written last."""
CHECKPOINT = "checkpoint.safetensors"
"""Between two segments."""
PARTIAL = "partial.safetensors"
"""Within the segment after the checkpoint."""
EPISODE_COLUMNS = ("step", "return", "length")
RECENT_EPISODES = 20
"""Training episodes over which return, length and reward per step are reported."""


def _labels(disturb: Iterable[str]) -> tuple[str, ...]:
    """Return the standard spellings of disturbances, sorted."""
    return tuple(each.label for each in parse_disturbances(tuple(disturb)))


@dataclass(frozen=True)
class TrainRun:
    """A training run. Equal runs give the same files, bit for bit, on the same machine.

    Raises:
        PerdureError: If there is no seed, one is named twice or out of range, the base method is unknown, or a
            disturbance is unknown or impossible here.
    """

    task: str
    method: str
    """Names the run's folder; the settings are all in ``config``."""
    config: Configuration
    seeds: tuple[int, ...] = (0,)
    """Trained side by side; each gives the same result as if trained alone."""
    command: str | None = None
    """Command that repeats the run, with `{seed}` for the seed; None: `perdure train ...`. Kept in the policy file."""
    preset: str | None = None
    """Preset of hyperparameters that `config` started from, part of the folder's name unless it is zoo. None: the usual
    one of the task."""
    base_method: str | None = None
    """Method that `config` started from, for the recorded command; None: `method`. Results do not depend on it."""
    inputs: str = ""
    """Digest of the files that the task reads; "" for none."""
    disturb: tuple[str, ...] = ()
    """What disturbs every training episode, all at once, sorted, such as "push:0.5"; each episode has its own draws."""
    start: Path | None = None
    """Policy that training continues, or a folder with one for each seed, see `perdure.learn.start`; None: new
    weights."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "disturb", _labels(self.disturb))
        for stage in self.stages:
            disturbances = parse_disturbances(stage.disturb)
            check_onsets(disturbances, stage.config.protocol.horizon.longest)
            disturbed_task(self.task, disturbances)
        object.__setattr__(self, "preset", self.preset or self.config.usual_preset(self.task))
        if self.base_method is not None:
            algorithm_of(self.base_method)
        if not self.seeds:
            raise PerdureError("a training run needs at least one seed")
        if min(self.seeds) < 0 or max(self.seeds) > MAX_SEED or len(set(self.seeds)) < len(self.seeds):
            raise PerdureError(f"seeds must be different numbers from 0 to {MAX_SEED:,}, got {list(self.seeds)}")
        for seed in self.seeds:
            self._start(seed)  # a missing file is reported before anything runs

    @cached_property
    def stages(self) -> tuple[Stage, ...]:
        """Return the parts of the run, each with all that disturbs its episodes."""
        stages = self.config.stages(self.task)
        return tuple(Stage(each.config, _labels({*self.disturb, *_labels(each.disturb)})) for each in stages)

    def key(self, seed: int) -> str:
        """Return the readable identity of one seed's run."""
        variant = self.method
        if self.preset not in UNNAMED_PRESETS:
            variant += f"@{self.preset}"
        task = self.task
        if is_contract(task):
            task = Path(task).name
        return f"{re.sub('[^A-Za-z0-9._+=,@()/-]', '_', task)}/{variant}/seed-{seed}"

    def identity(self, seed: int) -> dict[str, Any]:
        """Return everything that the result of one seed depends on."""
        identity = {"task": self.task, "method": self.method, "seed": seed, "config": self.config.to_json()}
        if self.preset not in UNNAMED_PRESETS:
            identity["preset"] = self.preset
        if self.disturb:
            identity["disturb"] = list(self.disturb)
        if len(self.stages) > 1:
            identity["then"] = [stage.to_json() for stage in self.stages[1:]]
        if self.inputs:
            identity["inputs"] = self.inputs
        if self.start is not None:
            identity["from"] = file_digest(Path(self._start(seed) or ""))
        source = task_source_digest(self.task)
        if source:
            identity["source"] = source
        return identity

    def _start(self, seed: int) -> str | None:
        """Return the policy that a seed continues as an absolute path, which another process can open."""
        return None if self.start is None else str(find_policy(start_file(self.start, seed)).resolve())

    @property
    def steps(self) -> int:
        """Return the environment steps of one seed, all stages together."""
        return sum(stage.steps for stage in self.stages)

    def unit(self, seed: int) -> Unit:
        """Return the training of one seed as a unit of work."""
        return Unit(
            self.key(seed),
            self.identity(seed),
            "perdure.learn.run:train_segment",
            {"run": self, "seed": seed, "start": self._start(seed)},
            size=float(self.steps),
            cores=max(stage.config.n_envs for stage in self.stages),
        )


def train(
    run: TrainRun,
    out: str | Path,
    *,
    cores: int | None = None,
    on: str = "here",
    observe: Observer | None = None,
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
        observe: Called with the progress of every seed; `on_report` makes an observer of a function of `Report`. By
            default a line is printed on standard error every half minute.
        waiting: Called once, before waiting for seeds that other commands train.

    Raises:
        PerdureError: There is no such task, the folder holds a run of the same name with other settings, training a
            seed failed, or ``cores`` or ``on`` is out of range.
    """
    check_on(on)
    store = Store(out)
    units = [run.unit(seed) for seed in run.seeds]
    store.warn_of_other_source(unit.key for unit in units)
    run_missing(units, out, on, cores, _both(say_advice(run), observe or Lines("train", "steps")), waiting)
    return [store.get(unit.key) / POLICY for unit in units]


def _both(first: Observer, second: Observer) -> Observer:
    def observe(status: Status) -> None:
        first(status)
        second(status)

    return observe


def kept_steps(run: TrainRun, out: str | Path) -> dict[int, int]:
    """Return the environment steps of each unfinished seed that its checkpoints keep; 0 without one.

    Args:
        run: The training run.
        out: The folder of the store that keeps the runs.
    """
    store = Store(out)
    kept = {}
    for seed in run.seeds:
        unit = run.unit(seed)
        if store.done(unit.key, unit.config):
            continue
        folder = store.work_folder(unit.key)
        kept[seed] = sum(
            _kept_steps(stage.config, stage_folder(folder, run, number)) for number, stage in enumerate(run.stages)
        )
    return kept


def _kept_steps(config: Configuration, folder: Path) -> int:
    """Return the environment steps of one stage that its folder keeps."""
    segments, _ = checkpoint_place(folder / CHECKPOINT)
    iterations = min(segments * config.segment_iterations, config.iterations)
    running_segment, partial = checkpoint_place(folder / PARTIAL)
    if running_segment == segments:
        iterations = max(iterations, partial)
    if (folder / POLICY).exists():
        iterations = config.iterations
    return iterations * config.iteration_steps


def stage_folder(folder: Path, run: TrainRun, number: int) -> Path:
    """Return the folder of a stage: that of the run for the last one, folders in it for those before."""
    if number == len(run.stages) - 1:
        return folder
    return folder / f"stage-{number + 1}"


def train_segment(work: Work, *, run: TrainRun, seed: int, start: str | None = None) -> bool:
    """Train one seed for one more segment; the function of `TrainRun.unit`.

    Args:
        work: The unit's folder and threads.
        run: The training run.
        seed: The training seed.
        start: File of the policy that it continues.

    Returns:
        Whether that was the last segment: then the policy and its learning curves are in the work folder.
    """
    for number in range(len(run.stages) - 1):
        folder = stage_folder(work.folder, run, number)
        if not _is_finished(folder):
            _train_stage(work, run, number, seed, start)
            return False
        start = str(folder / POLICY)
    return _is_finished(work.folder) or _train_stage(work, run, len(run.stages) - 1, seed, start)


def _is_finished(folder: Path) -> bool:
    """Return whether the policy of a stage is there; remove the checkpoint that an interrupted attempt left beside it.

    The policy is the last file that a stage writes.
    """
    if not (folder / POLICY).exists():
        return False
    (folder / CHECKPOINT).unlink(missing_ok=True)
    return True


def _train_stage(work: Work, run: TrainRun, number: int, seed: int, start: str | None) -> bool:
    """Train one seed for one more segment of a stage; return whether that was the stage's last one."""
    stage = run.stages[number]
    folder = stage_folder(work.folder, run, number)
    folder.mkdir(exist_ok=True)
    checkpoint = folder / CHECKPOINT
    segments = _segments(run.task, stage.config, work.threads, stage.disturb)
    before = sum(each.steps for each in run.stages[:number])
    # Where the stage stands: its first state, or that of its last checkpoint.
    policy = None
    if start is not None:
        policy = load_policy(start)
    state = segments.first(seed, policy)
    if checkpoint.exists():
        state = load_checkpoint(checkpoint, state)
    # One more segment.
    partial = folder / PARTIAL
    if state.segment < stage.config.segments:
        state = segments.run(state, lambda step, facts: work.report(before + step, run.steps, **facts), partial)
        save_checkpoint(state, checkpoint)
    partial.unlink(missing_ok=True)
    if state.segment < stage.config.segments:
        return False
    # The last one: learning curves, then the policy.
    previous = None
    if number:
        previous = stage_folder(work.folder, run, number - 1)
    _save_curves(state, segments, folder, before, previous)
    save_policy(export_policy(run, segments, state, start, number), folder / POLICY)
    checkpoint.unlink(missing_ok=True)
    return True


def _save_curves(state: RunState, segments: Segments, folder: Path, before: int, previous: Path | None) -> None:
    """Write the learning curves of a stage that is finished, after those of the stages before it.

    Args:
        state: After its last segment.
        segments: Its task and algorithm.
        folder: The stage's folder.
        before: Environment steps of the stages before it.
        previous: Folder of the stage before it; None: it is the first.
    """
    import polars as pl

    for name, columns in (("episodes", EPISODE_COLUMNS), ("iterations", segments.columns)):  # no wall-clock times
        curve = pl.DataFrame(dict(zip(columns, getattr(state, name).T, strict=True)))
        if previous is not None:
            here = curve.with_columns(pl.col("step") + before)
            curve = pl.concat([pl.read_parquet(previous / f"{name}.parquet"), here])
        write_atomic(folder / f"{name}.parquet", parquet_bytes(curve))


class Segments:
    """Runs segments of one task and configuration; keeps compiled programs. Results do not depend on `threads`."""

    def __init__(self, task: str, config: Configuration, threads: int, disturb: tuple[str, ...] = ()) -> None:
        self.spec = task_spec(task)
        self._disturbances = parse_disturbances(disturb)
        self._task = disturbed_task(task, self._disturbances)
        self._config = config
        self._threads = threads
        self.engine = self.spec.engine
        """Simulator of the training episodes, and its version."""
        if disturb:
            self.engine = task_spec(self._task).engine
        self.algorithm: Algorithm = config.make(self.spec)
        self._slot = WorldSlot()

    @property
    def columns(self) -> tuple[str, ...]:
        """Columns of the curve with a row for each iteration."""
        return ("step", *self.algorithm.diagnostics)

    def first(self, seed: int, start: Policy | None = None) -> RunState:
        """Return the state of a seed's run before its first segment; `start`: the policy that it continues."""
        episodes = np.zeros((0, len(EPISODE_COLUMNS)))
        iterations = np.zeros((0, len(self.columns)))
        return RunState(seed, 0, self.algorithm.init(seed, start), episodes, iterations)

    def run(
        self, state: RunState, progress: Callable[[int, dict[str, float]], None], partial: Path | None = None
    ) -> RunState:
        """Train a seed for its next segment. The memory of ``state``'s learner is reused.

        Args:
            state: After the segments so far.
            progress: Called after each iteration with (environment steps so far, facts): "return", "reward_per_step"
                and "length" of the last episodes, the algorithm's numbers, whose names begin with DIAGNOSTICS, and
                those for its advice.
            partial: File in which the running segment is kept; the result does not depend on it. A file of this segment
                is where training goes on.
        """
        try:
            return self._run(state, progress, partial)
        except ReplayError as error:
            step = state.segment * self._config.segment_iterations * self._config.iteration_steps
            warn(f"{error}; seed {state.seed} is trained again from step {step:,}")
        return self._run(state, progress, partial)

    def _run(
        self, state: RunState, progress: Callable[[int, dict[str, float]], None], partial: Path | None
    ) -> RunState:
        config = self._config
        seed = state.seed
        segment = state.segment
        first = segment * config.segment_iterations
        last = min(first + config.segment_iterations, config.iterations)
        # Of the environments: 31-bit numbers that share no simple pattern.
        seeds = [int(s) for s in np.random.SeedSequence([seed, segment]).generate_state(config.n_envs, np.uint32) >> 1]
        facts: dict[str, float] = {}
        world = make_world(self._task, seeds, threads=min(self._threads, len(seeds)))
        try:
            # New environments, disturbed if they are to be.
            if self._disturbances:
                spread = np.tile(self.algorithm.observation_std(state.learner), (len(seeds), 1))
                world = DisturbedWorld(world, self._disturbances, seeds, spread)
            observations = world.reset()
            self._slot.fill(world)
            learner, running = self.algorithm.start(state.learner, self._slot, observations, seed=seed, segment=segment)
            # Where a partial checkpoint left off, if there is one.
            recorder = Recorder(partial, world)
            begun = recorder.resume(dataclasses.replace(state, learner=learner), running, first)
            state = begun
            running = begun.running
            # Learn. Observation noise scales with the spread of the observations so far.
            for iteration in range(begun.iteration, last):
                if isinstance(world, DisturbedWorld):
                    world.observation_std[:] = self.algorithm.observation_std(state.learner)
                learner, running, metrics = self.algorithm.iterate(
                    state.learner, running, seed=seed, iteration=iteration
                )
                if self._slot.error is not None:
                    raise self._slot.error
                step = (iteration + 1) * config.iteration_steps
                row = np.array([[step, *metrics.diagnostics.values()]])
                episodes = np.concatenate([state.episodes, metrics.episodes])
                state = RunState(seed, segment, learner, episodes, np.concatenate([state.iterations, row]))
                # Keep, then tell.
                recorder.keep(state, running, iteration + 1, metrics.sent)
                own = {f"{DIAGNOSTICS}{name}": value for name, value in metrics.diagnostics.items()}
                facts |= metrics.facts
                progress(step, {**_recent_episodes(episodes), **facts, **own})
        except Exception as error:
            if self._slot.error is None or error is self._slot.error:
                raise
            raise self._slot.error from None
        finally:
            self._slot.clear()
            world.close()
        return RunState(seed, segment + 1, state.learner, state.episodes, state.iterations)


_segments = lru_cache(maxsize=1)(Segments)
"""Keeps the compiled programs from segment to segment."""


def _recent_episodes(episodes: NDArray[np.float64]) -> dict[str, float]:
    """Return means over the last RECENT_EPISODES of these rows; nan if there are none."""
    _, returns, lengths = episodes[-RECENT_EPISODES:].T
    if not len(returns):
        return dict.fromkeys(("return", "reward_per_step", "length"), math.nan)
    return {
        "return": float(returns.mean()),
        "reward_per_step": float(returns.sum() / lengths.sum()),
        "length": float(lengths.mean()),
    }
