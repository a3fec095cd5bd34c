"""Curves and intervals of one method under one rule for its clock, by `perdure.report`."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import polars as pl

from perdure.report.curves import Curve
from perdure.report.estimates import Estimate, estimate_group
from perdure.report.groups import make_groups
from perdure.report.statistics import (
    FEWEST_FOR_INTERVAL,
    TRAINING_SEEDS,
    FloatArray,
    Interval,
    Units,
    t_interval,
)
from perdure.report.theme import Style
from perdure.studies.horizon.claim import Condition
from perdure.studies.horizon.results import Results
from perdure.studies.horizon.tables import RowTable

SEED = 0
"""Of the bootstrap's generator: the same tables, the same intervals."""


def estimate_condition(results: Results, setting: str, condition: Condition) -> Estimate | None:
    """Return the estimate of a condition on test start states; None where it is not evaluated."""
    row = results.grid.row(setting, condition.method)
    if row is None or row.key not in results.test:
        return None
    return estimate_under(results.test[row.key], results.clocks(row, condition.clock))


def estimate_under(table: RowTable, clocks: Mapping[int, str]) -> Estimate | None:
    """Return the estimate of training runs, each under its own clock; None where there is no such lane."""
    wanted = pl.DataFrame({"train_seed": list(clocks), "clock": list(clocks.values())}, schema=_WANTED)
    lanes = table.frame.join(wanted, on=["train_seed", "clock"], how="semi", maintain_order="left")
    if lanes.is_empty():
        return None
    (group,) = make_groups(lanes.with_columns(clock=pl.lit("chosen"), clock_steps=pl.lit(float("nan"))))
    return estimate_group(group, np.random.default_rng(SEED))


_WANTED = {"train_seed": pl.Int64, "clock": pl.String}


def reward_curve(label: str, estimate: Estimate, style: Style, bands: bool = True) -> Curve:
    """Return the mean reward per step so far against steps."""
    steps = estimate.steps.astype(np.float64)
    return interval_curve(label, steps, estimate.returns, style, steps, bands)


def working_curve(label: str, estimate: Estimate, style: Style) -> Curve:
    """Return the share of episodes that have not failed against steps (Kaplan-Meier)."""
    steps = estimate.steps.astype(np.float64)
    return interval_curve(label, steps, estimate.working, style, np.ones_like(steps), bands=False)


def interval_curve(
    label: str, x: FloatArray, interval: Interval, style: Style, divisor: FloatArray | None = None, bands: bool = True
) -> Curve:
    """Return an interval as a curve; without bounds where there are too few training runs."""
    by = np.ones_like(x) if divisor is None else divisor
    few = interval.count < FEWEST_FOR_INTERVAL
    return Curve(
        label,
        x,
        interval.estimate / by,
        style,
        None if few else interval.lower / by,
        None if few else interval.upper / by,
        intervals="band" if bands else "last",
    )


def run_interval(values: Mapping[int, float]) -> Interval:
    """Return the mean over training runs with Student's t interval, as tables and claims have it."""
    return t_interval(Units(np.array([values[seed] for seed in sorted(values)]), TRAINING_SEEDS))


def bounds(interval: Interval) -> tuple[float, float, float]:
    """Return (mean, lower, upper); nan bounds where there are too few training runs."""
    few = interval.count < FEWEST_FOR_INTERVAL
    lower, upper = (np.nan, np.nan) if few else (float(interval.lower), float(interval.upper))
    return float(interval.estimate), lower, upper


def interval_note(intervals: list[Interval], what: str) -> str:
    """Return the kind of the intervals and the number of training runs as text."""
    many = [each for each in intervals if each.count >= FEWEST_FOR_INTERVAL]
    if not many:
        return f"No intervals: fewer than {FEWEST_FOR_INTERVAL} training runs."
    counts = sorted({each.count for each in many})
    runs = f"{counts[0]}" if len(counts) == 1 else f"{counts[0]} to {counts[-1]}"
    methods = " or ".join(dict.fromkeys(each.method for each in many))
    return f"{what}: pointwise 95 % intervals ({methods}), n = {runs} training runs."
