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
from perdure.report.statistics import survival_interval

if TYPE_CHECKING:
    import polars as pl

FloatArray = NDArray[np.float64]


def stage_table(records: Sequence[EpisodeLog], rng: np.random.Generator) -> pl.DataFrame:
    """One row per task, split, strategy, way of counting and stage; the last stage is the task's success.

    Columns: `episodes` and `runs` that were counted, `mean` and `standard_error` over the runs (nan for one run),
    `lower` and `upper` of the 95 % interval, its `units` (training seeds, or evaluation seeds only) and `method`.

    Args:
        records: The episodes.
        rng: The bootstrap's only source of randomness.
    """
    import polars as pl

    rows: list[tuple[object, ...]] = []
    for group, part in grouped(records).items():
        names = [stage.name for stage in part[0].home_task.stages]
        seeds = np.array([record.train_seed for record in part])
        runs = np.array([f"{record.train_seed} {record.eval_seed}" for record in part])
        for counting in COUNTINGS:
            count = latched if counting == "latched" else stages_stabilizing
            reached = np.array([count(record) for record in part], dtype=np.float64)
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
    """Mean of the runs' means and its standard error, s / sqrt(n) with s of n - 1 degrees of freedom; nan for one run.

    Args:
        values: One row per episode. Shape (episodes, *).
        runs: Which run each episode belongs to. Shape (episodes,).
    """
    means = np.stack([values[runs == run].mean(axis=0) for run in np.unique(runs)])
    n = len(means)
    error = means.std(axis=0, ddof=1) / math.sqrt(n) if n > 1 else np.full(means.shape[1:], np.nan)
    return means.mean(axis=0), error


def grouped(records: Sequence[EpisodeLog]) -> dict[tuple[str, str, str], list[EpisodeLog]]:
    """Records by task, split and strategy, in the order of their first one."""
    groups: dict[tuple[str, str, str], list[EpisodeLog]] = {}
    for record in records:
        groups.setdefault((record.task, record.split, record.strategy), []).append(record)
    return groups
