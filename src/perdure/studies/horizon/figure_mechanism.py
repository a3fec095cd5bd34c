"""Mechanism: reward against steps to go, error and spread of the critic, dependence of the action on C."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
import polars as pl

from perdure.report import theme
from perdure.report.axes import Axis
from perdure.report.curves import Curve, curve_chart
from perdure.report.render import Figure, slug
from perdure.report.rows import Points, point_chart
from perdure.report.statistics import TRAINING_SEEDS, Interval, Units, estimate_interval
from perdure.studies.horizon import styles, words
from perdure.studies.horizon.claim import MEASURES, Condition
from perdure.studies.horizon.estimates import SEED, bounds, interval_curve, interval_note, run_interval
from perdure.studies.horizon.mechanism import ACTIONS, BINS, read_details
from perdure.studies.horizon.results import Results

METHODS = ("ppo", "ppo-undiscounted", "random-horizon", "linear", "geometric", "geometric-fixed")
VALUES = ("value error", "value variance")


def mechanism_figures(results: Results) -> Iterator[Figure]:
    """Return the figures of the mechanism stage; none where it was not run."""
    bins = read_details(results.grid, results.out, BINS)
    actions = read_details(results.grid, results.out, ACTIONS)
    for setting in results.grid.settings:
        axes = Axis("steps to go of the training horizon"), Axis("mean reward per step")
        yield from _curves(bins, setting, "steps to go", "reward", axes, "reward-to-go", "Reward by steps to go")
        axes = (
            Axis("C: steps to go given to the policy"),
            Axis("change of the action, as a share of the action box", low=0.0),
        )
        title = "Change of the action with C instead of 500 steps to go"
        yield from _curves(actions, setting, "C", "change", axes, "action-dependence", title)
    for measure in VALUES:
        yield from _values(results, measure)


def _curves(
    frame: pl.DataFrame, setting: str, x: str, y: str, axes: tuple[Axis, Axis], name: str, title: str
) -> Iterator[Figure]:
    curves: list[Curve] = []
    intervals: list[Interval] = []
    for method in METHODS if len(frame) else ():
        part = frame.filter((pl.col("setting") == setting) & (pl.col("method") == method))
        if part.is_empty():
            continue
        places, interval = _over_runs(part, x, y)
        if axes[1].low is not None:
            interval = replace(interval, lower=np.maximum(interval.lower, axes[1].low))
        curves.append(interval_curve(words.method(method), places, interval, styles.style(Condition(method))))
        intervals.append(interval)
    if curves:
        note = (
            f"Short rollouts of the mean action, as far as every training run came. {interval_note(intervals, 'Bands')}"
        )
        yield Figure(slug(name, setting), title, curve_chart(curves, *axes), note, words.setting(setting))


def _over_runs(part: pl.DataFrame, x: str, y: str) -> tuple[np.ndarray[tuple[int], np.dtype[np.float64]], Interval]:
    """Return the places that every training run reached, and the mean over runs at each."""
    wide = part.pivot(on="train_seed", index=x, values=y).drop_nulls().sort(x)
    runs = wide.drop(x).to_numpy().T
    return wide[x].to_numpy().astype(np.float64), estimate_interval(
        Units(np.ascontiguousarray(runs), TRAINING_SEEDS), np.random.default_rng(SEED)
    )


def _values(results: Results, measure: str) -> Iterator[Figure]:
    settings, points, intervals = _value_points(results, measure)
    if points:
        names = [words.setting(setting) for setting in settings]
        note = f"{MEASURES[measure].capitalize()}. {interval_note(intervals, 'Bars')}"
        chart = point_chart(names, points, Axis(measure), theme.WIDE)
        yield Figure(slug(measure), f"The critic: {measure}", chart, note, wide=True)


def _value_points(results: Results, measure: str) -> tuple[list[str], list[Points], list[Interval]]:
    found = {
        (setting, method): run_interval(values)
        for setting in results.grid.settings
        for method in METHODS
        if (values := results.values(setting, Condition(method), measure))
    }
    settings = [setting for setting in results.grid.settings if any(each == setting for each, _ in found)]
    points = []
    for method in dict.fromkeys(method for _, method in found):
        rows: Sequence[int] = [k for k, setting in enumerate(settings) if (setting, method) in found]
        columns = zip(*(bounds(found[settings[row], method]) for row in rows), strict=True)
        mean, lower, upper = (np.array(column) for column in columns)
        points.append(Points(words.method(method), rows, mean, styles.style(Condition(method)), lower, upper))
    return settings, points, list(found.values())
