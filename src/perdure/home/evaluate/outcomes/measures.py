"""Success per stage over runs: mean, standard error and a 95 % interval.

A run is one training seed with one evaluation seed over all episodes of a split: the benchmark's 3 x 3 runs of 100
episodes. Mean and standard error are those over the runs (as M3 and the thesis report them). Runs that share a training
seed are not independent, so training seeds are the units of the interval where there are several (Student's t below
ten of them); where there is one it is Wilson's over episodes, which keeps a width when all succeed, and says so.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from perdure.home.evaluate.log import EpisodeLog
from perdure.home.evaluate.outcomes.counting import latched, stages_stabilizing
from perdure.home.evaluate.outcomes.labels import COUNTINGS
from perdure.home.evaluate.outcomes.placements import GROUP
from perdure.home.sim.arrays import FloatArray
from perdure.report.statistics import survival_interval

if TYPE_CHECKING:
    import polars as pl


def stage_table(logs: Sequence[EpisodeLog], rng: np.random.Generator) -> pl.DataFrame:
    """Return one row per task, split, strategy, way of counting and stage; the last stage is the task's success.

    Columns: `episodes` and `runs` that were counted, `mean` and `standard_error` over the runs (nan for one run),
    `lower` and `upper` of the 95 % interval, its `units` (training seeds, or evaluation seeds only) and `method`.

    Args:
        logs: The episodes.
        rng: The bootstrap's only source of randomness.
    """
    import polars as pl

    rows: list[tuple[object, ...]] = []
    for group, part in grouped(logs).items():
        names = [stage.name for stage in part[0].home_task.stages]
        seeds = np.array([log.train_seed for log in part])
        runs = np.array([f"{log.train_seed} {log.eval_seed}" for log in part])
        for counting in COUNTINGS:
            count = latched if counting == "latched" else stages_stabilizing
            reached = np.array([count(log) for log in part], dtype=np.float64)
            mean, error = over_runs(reached, runs)
            interval = survival_interval(reached, seeds, rng)
            for k, name in enumerate(names):
                bounds = (float(mean[k]), float(error[k]), float(interval.lower[k]), float(interval.upper[k]))
                rows.append(
                    (*group, counting, name, len(part), len(set(runs)), *bounds, interval.label, interval.method)
                )
    real = dict.fromkeys(("mean", "standard_error", "lower", "upper"), pl.Float64)
    keys = {**dict.fromkeys((*GROUP, "counting", "stage"), pl.String), "episodes": pl.Int64, "runs": pl.Int64}
    return pl.DataFrame(rows, schema={**keys, **real, "units": pl.String, "method": pl.String}, orient="row")


def over_runs(values: FloatArray, runs: NDArray[np.str_]) -> tuple[FloatArray, FloatArray]:
    """Return the mean of the runs' means and its standard error s / sqrt(n), n - 1 degrees of freedom; nan for one run.

    Args:
        values: One row per episode. Shape (episodes, *).
        runs: Which run each episode belongs to. Shape (episodes,).
    """
    means = np.stack([values[runs == run].mean(axis=0) for run in np.unique(runs)])
    n = len(means)
    error = means.std(axis=0, ddof=1) / math.sqrt(n) if n > 1 else np.full(means.shape[1:], np.nan)
    return means.mean(axis=0), error


def grouped(logs: Sequence[EpisodeLog]) -> dict[tuple[str, str, str], list[EpisodeLog]]:
    """Return logs by task, split and strategy, in the order of their first one."""
    groups: dict[tuple[str, str, str], list[EpisodeLog]] = {}
    for log in logs:
        groups.setdefault((log.task, log.split, log.strategy), []).append(log)
    return groups
