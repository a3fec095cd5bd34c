"""Training runs: seeds of one task and method, in segments, checkpointed, resumed, and turned into policy files.

A seed's run is a chain of segments. Each one begins with the checkpoint in the run's folder and leaves the next. It
builds its environments from (seed, segment) alone and cuts running episodes as the end of a rollout does, because an
engine's inner state and random generator cannot be saved. So a run that was killed and a run that was not are the same
run. A run knows no detail of its algorithm, only the interface `Algorithm`.
"""

from __future__ import annotations

import dataclasses
import math
import re
import shlex
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from perdure.disturbances import check_onsets, parse_disturbances
from perdure.envs import TaskSpec, make_world, task_spec
from perdure.envs.disturbances import DisturbedWorld, disturbed_task
from perdure.envs.suites import is_contract, task_source_digest
from perdure.envs.traced import WorldSlot
from perdure.envs.world import MAX_SEED
from perdure.errors import PerdureError
from perdure.horizon import Embedding
from perdure.learn.algorithm import Algorithm, Configuration, algorithm_of, all_methods, usual_config
from perdure.learn.checkpoint import RunState, checkpoint_segments, load_checkpoint, save_checkpoint
from perdure.learn.first_rollout import say_advice
from perdure.learn.presets import ZOO
from perdure.learn.start import start_file, trained_steps
from perdure.policy import Policy, find_policy, load_policy, measure_reference, save_policy
from perdure.runs import (
    Observer,
    Status,
    Store,
    Unit,
    Work,
    check_on,
    file_digest,
    run_missing,
    versions,
    write_atomic,
)
from perdure.runs.progress import Lines, total_share
from perdure.schema import parquet_bytes

POLICY = "policy.safetensors"
"""Written last."""
CHECKPOINT = "checkpoint.safetensors"
EPISODE_COLUMNS = ("step", "return", "length")
UNNAMED_PRESETS = (ZOO, None)
"""Presets that folders and policy files do not name."""
RECENT_EPISODES = 20
"""Training episodes over which return, length and reward per step are reported."""
DIAGNOSTICS = "diagnostics/"
"""Begins the names of an algorithm's own numbers among the facts of a report. TensorBoard shows them, the line of
progress does not."""


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
        disturbances = parse_disturbances(self.disturb)
        check_onsets(disturbances, self.config.protocol.horizon.longest)
        disturbed_task(self.task, disturbances)
        object.__setattr__(self, "disturb", tuple(each.label for each in disturbances))
        object.__setattr__(self, "preset", self.preset or self.config.usual_preset(self.task))
        if self.base_method is not None:
            algorithm_of(self.base_method)
        if not self.seeds:
            raise PerdureError("a training run needs at least one seed")
        if min(self.seeds) < 0 or max(self.seeds) > MAX_SEED or len(set(self.seeds)) < len(self.seeds):
            raise PerdureError(f"seeds must be different numbers from 0 to {MAX_SEED:,}, got {list(self.seeds)}")
        for seed in self.seeds:
            self._start(seed)  # a missing file is reported before anything runs

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

    def unit(self, seed: int) -> Unit:
        """Return the training of one seed as a unit of work."""
        steps = float(self.config.iterations * self.config.iteration_steps)
        return Unit(
            self.key(seed),
            self.identity(seed),
            "perdure.learn.run:train_segment",
            {"run": self, "seed": seed, "start": self._start(seed)},
            size=steps,
            cores=self.config.n_envs,
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
    """Return the environment steps of each unfinished seed that its checkpoint keeps; 0 without a checkpoint.

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
        segments = checkpoint_segments(store.work_folder(unit.key) / CHECKPOINT)
        iterations = min(segments * run.config.segment_iterations, run.config.iterations)
        kept[seed] = iterations * run.config.iteration_steps
    return kept


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
    reward_per_step: float = math.nan
    """Mean reward of a step in these episodes. Other than the return, it compares methods whose episodes have other
    lengths."""
    mean_length: float = math.nan
    """Mean length of these episodes in steps."""
    diagnostics: Mapping[str, float] = field(default_factory=dict)
    """The algorithm's own numbers of its last iteration, such as its losses."""


def on_report(run: TrainRun, callback: Callable[[Report], None]) -> Observer:
    """Return an observer that calls `callback` with a `Report` whenever a seed has made progress."""
    last: dict[int, float] = {}

    def observe(status: Status) -> None:
        for seed in run.seeds:
            progress = status[run.key(seed)]
            if progress.facts and progress.done != last.get(seed):
                last[seed] = progress.done
                facts = progress.facts
                report = Report(
                    seed=seed,
                    step=int(progress.done),
                    steps=int(progress.total),
                    mean_return=facts.get("return", math.nan),
                    share=total_share(status),
                    reward_per_step=facts.get("reward_per_step", math.nan),
                    mean_length=facts.get("length", math.nan),
                    diagnostics={
                        name.removeprefix(DIAGNOSTICS): value
                        for name, value in facts.items()
                        if name.startswith(DIAGNOSTICS)
                    },
                )
                callback(report)

    return observe


@contextmanager
def tensorboard(folder: Path) -> Iterator[Callable[[Report], None]]:
    """Return a function of reports that writes them for TensorBoard, at the seed's step.

    The curves are ``train/seed-N/mean_return``, ``mean_length``, ``reward_per_step`` and the algorithm's own, such as
    ``approx_kl`` and ``explained_variance``.

    Raises:
        PerdureError: If tensorboardX is not installed.
    """
    try:
        from tensorboardX import SummaryWriter
    except ImportError:
        raise PerdureError("TensorBoard output needs tensorboardX: pip install 'perdure[tensorboard]'") from None
    writer = SummaryWriter(str(folder))

    def watch(report: Report) -> None:
        values = {name: getattr(report, name) for name in ("mean_return", "mean_length", "reward_per_step")}
        values.update(report.diagnostics)
        for name, value in values.items():
            if not math.isnan(value):
                writer.add_scalar(f"train/seed-{report.seed}/{name}", value, report.step)

    try:
        yield watch
    finally:
        writer.close()


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
    import polars as pl

    segments = _segments(run.task, run.config, work.threads, run.disturb)
    checkpoint = work.folder / CHECKPOINT
    steps = run.config.iterations * run.config.iteration_steps
    if (work.folder / POLICY).exists():  # an attempt that was interrupted after its last file
        checkpoint.unlink(missing_ok=True)
        return True
    # Where the run stands: its first state, or that of its last checkpoint.
    policy = None
    if start is not None:
        policy = load_policy(start)
    state = segments.first(seed, policy)
    if checkpoint.exists():
        state = load_checkpoint(checkpoint, state)
    # One more segment.
    if state.segment < run.config.segments:
        state = segments.run(state, lambda step, facts: work.report(step, steps, **facts))
        save_checkpoint(state, checkpoint)
    if state.segment < run.config.segments:
        return False
    # The last one: learning curves, then the policy, whose file says that all is there.
    for name, columns in (("episodes", EPISODE_COLUMNS), ("iterations", segments.columns)):  # no wall-clock times
        curve = pl.DataFrame(dict(zip(columns, getattr(state, name).T, strict=True)))
        write_atomic(work.folder / f"{name}.parquet", parquet_bytes(curve))
    save_policy(export_policy(run, segments, state, start), work.folder / POLICY)
    checkpoint.unlink(missing_ok=True)
    return True


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

    def run(self, state: RunState, progress: Callable[[int, dict[str, float]], None]) -> RunState:
        """Train a seed for its next segment. The memory of ``state``'s learner is reused.

        Args:
            state: After the segments so far.
            progress: Called after each iteration with (environment steps so far, facts): "return", "reward_per_step"
                and "length" of the last episodes, the algorithm's numbers, whose names begin with DIAGNOSTICS, and
                those for its advice.
        """
        config = self._config
        seed = state.seed
        segment = state.segment
        first = segment * config.segment_iterations
        last = min(first + config.segment_iterations, config.iterations)
        # Of the environments: 31-bit numbers that share no simple pattern.
        seeds = [int(s) for s in np.random.SeedSequence([seed, segment]).generate_state(config.n_envs, np.uint32) >> 1]
        learner = state.learner
        facts: dict[str, float] = {}
        episodes = [state.episodes]
        iterations = [state.iterations]
        world = make_world(self._task, seeds, threads=min(self._threads, len(seeds)))
        try:
            # New environments, disturbed if they are to be.
            if self._disturbances:
                spread = np.tile(self.algorithm.observation_std(learner), (len(seeds), 1))
                world = DisturbedWorld(world, self._disturbances, seeds, spread)
            observations = world.reset()
            self._slot.fill(world)
            learner, running = self.algorithm.start(learner, self._slot, observations, seed=seed, segment=segment)
            # Learn. Observation noise scales with the spread of the observations so far.
            for iteration in range(first, last):
                if isinstance(world, DisturbedWorld):
                    world.observation_std[:] = self.algorithm.observation_std(learner)
                learner, running, metrics = self.algorithm.iterate(learner, running, seed=seed, iteration=iteration)
                if self._slot.error is not None:
                    raise self._slot.error
                step = (iteration + 1) * config.iteration_steps
                episodes.append(metrics.episodes)
                iterations.append(np.array([[step, *metrics.diagnostics.values()]]))
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
        return RunState(seed, segment + 1, learner, np.concatenate(episodes), np.concatenate(iterations))


_segments = lru_cache(maxsize=1)(Segments)
"""Keeps the compiled programs from segment to segment."""


def _recent_episodes(episodes: list[NDArray[np.float64]]) -> dict[str, float]:
    """Return means over the last RECENT_EPISODES of these rows; nan if there are none."""
    _, returns, lengths = np.concatenate(episodes)[-RECENT_EPISODES:].T
    if not len(returns):
        return dict.fromkeys(("return", "reward_per_step", "length"), math.nan)
    return {
        "return": float(returns.mean()),
        "reward_per_step": float(returns.sum() / lengths.sum()),
        "length": float(lengths.mean()),
    }


def export_policy(run: TrainRun, segments: Segments, state: RunState, start: str | None = None) -> Policy:
    """Return the policy of the final weights, with its provenance, measured within its training horizon.

    Args:
        run: The training run.
        segments: Its task and algorithm.
        state: After its last segment.
        start: File of the policy that it continued.
    """
    provenance: dict[str, Any] = {
        "method": run.method,
        "seed": state.seed,
        "config": run.config.to_json(),
        "engine": segments.engine,
        "versions": versions("jax", "numpy", "mujoco"),
        "command": command(run, segments.spec, state.seed),
    }
    if run.preset not in UNNAMED_PRESETS:
        provenance["preset"] = run.preset
    if run.disturb:
        provenance["disturb"] = list(run.disturb)
    if start is not None:
        provenance["from"] = _continued(start)
    policy = dataclasses.replace(segments.algorithm.policy(state.learner), provenance=provenance)
    return dataclasses.replace(policy, reference=measure_reference(policy))


def _continued(start: str) -> dict[str, Any]:
    """Return what a policy file says of the policy that it continues: its digest, and the steps it was trained for."""
    return {"sha256": file_digest(Path(start)), "steps": trained_steps(load_policy(start))}


def command(run: TrainRun, spec: TaskSpec, seed: int) -> str:
    """Return the command that reproduces this policy; "" where no flags say its settings."""
    if run.command is not None:
        return run.command.replace("{seed}", str(seed))
    base = run.base_method or run.method
    if base not in all_methods():
        return ""
    words = ["perdure", "train", run.task, "--method", base]
    preset = None
    if run.method != base:
        words += ["--name", run.method]
    if run.config.presets:
        preset = run.preset
        words += ["--preset", str(preset)]
    words += ["--seeds", str(seed)]
    if run.disturb:
        words += ["--disturb", *run.disturb]
    if run.start is not None:
        words += ["--from", str(run.start)]
    usual = usual_config(base, run.task, spec.observation_size, preset, spec.default_horizon)
    try:
        words += _overrides(run.config, usual, f"--{run.config.name}")
    except LookupError:
        return ""
    return shlex.join(words)


def _overrides(config: Any, default: Any, flag: str) -> list[str]:
    words: list[str] = []
    for each in dataclasses.fields(config):
        value = getattr(config, each.name)
        usual = getattr(default, each.name)
        name = f"{flag}.{each.name.replace('_', '-')}"
        if value == usual:
            continue
        if isinstance(usual, Embedding):  # its flag accepts the method's embedding only
            raise LookupError(name)
        if dataclasses.is_dataclass(value) and type(value) is type(usual):
            words += _overrides(value, usual, name)
        elif dataclasses.is_dataclass(value):
            raise LookupError(name)
        elif isinstance(value, bool):
            words.append(name if value else f"{flag}.no-{each.name.replace('_', '-')}")
        elif isinstance(value, tuple):
            words += [name, *(str(item) for item in value)]
        else:
            words += [name, str(value)]
    return words
