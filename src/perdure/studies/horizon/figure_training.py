"""Figure A-1: returns of the training episodes with and without a linear time-to-go."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import polars as pl

from perdure.report import wording
from perdure.report.axes import Axis
from perdure.report.curves import curve_chart
from perdure.report.render import Figure, slug
from perdure.report.statistics import TRAINING_SEEDS, FloatArray, Units, estimate_interval
from perdure.studies.files import read_parquet_file
from perdure.studies.horizon import styles, words
from perdure.studies.horizon.claim import Condition
from perdure.studies.horizon.estimates import SEED, interval_curve, interval_note
from perdure.studies.horizon.results import Results
from perdure.studies.horizon.training import EPISODES, seed_folders

METHODS = ("ppo", "linear", "linear-10-workers")
POINTS = 50
"""Of each curve; a point is the mean of the episodes that ended since the one before."""


def training_figures(results: Results) -> Iterator[Figure]:
    """Return figure A-1 for every setting that has both PPO and the linear method."""
    for setting in results.grid.settings:
        found = {}
        for name in METHODS:
            row = results.grid.row(setting, name)
            folders = {} if row is None else seed_folders(results.out, row)
            if folders:
                found[name] = [read_parquet_file(folder / EPISODES) for folder in folders.values()]
        if {"ppo", "linear"} <= set(found):
            yield _figure(setting, found)


def _figure(setting: str, found: dict[str, list[pl.DataFrame]]) -> Figure:
    last = max(float(frame["step"].max() or 1.0) for frames in found.values() for frame in frames)  # type: ignore[arg-type]
    curves, intervals = [], []
    for name, frames in found.items():
        edges = np.linspace(0.0, last, POINTS + 1)
        units = Units(np.stack([episode_means(frame, edges) for frame in frames]), TRAINING_SEEDS)
        interval = estimate_interval(units, np.random.default_rng(SEED))
        intervals.append(interval)
        curves.append(interval_curve(words.method(name), edges[1:], interval, styles.style(Condition(name))))
    note = "Sampled actions, as in training. To the linear methods the horizon is also an end. "
    note += interval_note(intervals, "Bands")
    runs = wording.sample([len(frames) for frames in found.values()], "training run")
    axes = Axis("training steps"), Axis(f"mean return of training episodes ({runs})")
    chart = curve_chart(curves, *axes)
    return Figure(slug("figure-a-1", setting), "Training returns", chart, note, words.setting(setting))


def episode_means(episodes: pl.DataFrame, edges: FloatArray) -> FloatArray:
    """Return the mean return of the episodes that ended in each interval, shape (points,).

    Where none ended, the one before stands.
    """
    place = np.searchsorted(edges, episodes["step"].to_numpy(), side="left") - 1
    found = np.full(len(edges) - 1, np.nan)
    returns = episodes["return"].to_numpy()
    for k in range(len(found)):
        here = returns[place == k]
        found[k] = here.mean() if len(here) else found[k - 1] if k else np.nan
    return found
