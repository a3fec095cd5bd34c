"""Write the files of a finished training run."""

from __future__ import annotations

import dataclasses
import importlib.metadata
import io
import math
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from perdure.horizon import Embedding
from perdure.policy import Normalizer, Policy, TaskInfo, measure_reference
from perdure.ppo.methods import METHODS, default_clock, method_config
from perdure.ppo.normalizer import CLIP, EPSILON
from perdure.ppo.presets import ZOO
from perdure.ppo.state import EPISODE_COLUMNS, ITERATION_COLUMNS, SeedState
from perdure.runs import write_atomic

if TYPE_CHECKING:
    from perdure.envs import TaskSpec
    from perdure.ppo.training import TrainRun


def export_policy(run: TrainRun, spec: TaskSpec, state: SeedState) -> Policy:
    """Return the policy of the final weights, measured within its training horizon."""
    moments = state.statistics.observations
    policy = Policy(
        task=TaskInfo(
            spec.name, spec.observation_size, tuple(spec.action_low.tolist()), tuple(spec.action_high.tolist())
        ),
        weights={name: np.asarray(value) for name, value in state.params.items()},
        activation=run.config.activation,
        normalizer=Normalizer(np.asarray(moments.mean), np.asarray(moments.var), CLIP, EPSILON),
        protocol=run.config.protocol,
        clock=default_clock(run.config),
        provenance={
            "method": run.method,
            "seed": state.seed,
            "config": run.config.to_json(),
            "engine": spec.engine,
            "versions": {name: importlib.metadata.version(name) for name in ("perdure", "jax", "numpy", "mujoco")},
            "command": command(run, spec, state.seed),
            **({} if run.preset == ZOO else {"preset": run.preset}),
        },
        return_scale=math.sqrt(float(state.statistics.returns.var[0]) + EPSILON),
    )
    return dataclasses.replace(policy, reference=measure_reference(policy))


def command(run: TrainRun, spec: TaskSpec, seed: int) -> str:
    """Return the command that reproduces this policy; "" where no flags say its settings."""
    if run.command is not None:
        return run.command.replace("{seed}", str(seed))
    base = run.base_method or run.method
    if base not in METHODS:
        return ""
    words = ["perdure", "train", run.task, "--method", base]
    words += [] if run.method == base else ["--name", run.method]
    words += ["--seeds", str(seed)]
    words += [] if run.preset == ZOO else ["--preset", run.preset]
    usual = method_config(base, run.task, spec.observation_size, run.preset)
    try:
        words += _overrides(run.config, usual, "--ppo")
    except LookupError:
        return ""
    return shlex.join(words)


def _overrides(config: Any, default: Any, flag: str) -> list[str]:
    words: list[str] = []
    for each in dataclasses.fields(config):
        value, usual = getattr(config, each.name), getattr(default, each.name)
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


def write_curves(state: SeedState, folder: Path) -> None:
    """Write the learning curves ``episodes.parquet`` and ``iterations.parquet``, without wall-clock times."""
    _write_table(folder / "episodes.parquet", EPISODE_COLUMNS, state.episodes)
    _write_table(folder / "iterations.parquet", ITERATION_COLUMNS, state.iterations)


def _write_table(path: Path, columns: tuple[str, ...], rows: NDArray[np.float64]) -> None:
    import polars as pl

    buffer = io.BytesIO()
    pl.DataFrame({name: rows[:, i] for i, name in enumerate(columns)}).write_parquet(buffer)
    write_atomic(path, buffer.getvalue())
