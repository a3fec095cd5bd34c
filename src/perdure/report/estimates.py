"""Estimates of a group, shared by figures, table and verdict."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from perdure.report.groups import FloatArray, Group, IntArray
from perdure.report.statistics import (
    DEFAULT,
    Bootstrap,
    Interval,
    estimate_interval,
    make_units,
    mean_interval,
    survival_interval,
)
from perdure.report.verdict import Verdict, judge

MOST_POINTS = 80
"""Recorded steps drawn per curve; a table may hold many more."""


@dataclass(frozen=True)
class Estimate:
    """A group with its means and intervals."""

    group: Group
    steps: IntArray
    """The recorded steps kept, shape (points,); the last one is the table's last."""
    returns: Interval
    """Mean cumulative return, shape (points,)."""
    return_units: FloatArray
    """Of the units of these intervals, shape (units, points)."""
    survival: Interval
    """Share of lanes alive, shape (points,)."""
    working: Interval
    """Share of episodes without a failure so far (Kaplan-Meier), shape (points,); no bounds once an episode is cut."""
    final_hold: Interval
    """Hold score at the end, ended episodes count 0; shape ()."""
    verdict: Verdict

    @property
    def final_return(self) -> float:
        """Mean return at the last recorded step."""
        return float(self.returns.estimate[-1])


def estimate_group(group: Group, rng: np.random.Generator, how: Bootstrap = DEFAULT) -> Estimate:
    """Estimate a group: lanes averaged within training runs, intervals over runs (see `statistics`)."""
    kept = thin(group.steps, MOST_POINTS)
    known = np.isfinite(group.final_hold)
    rows = known if known.any() else np.ones_like(known)
    units = make_units(group.returns[:, kept], group.runs)
    return Estimate(
        group=group,
        steps=group.steps[kept],
        returns=estimate_interval(units, rng, how),
        return_units=units.values,
        survival=survival_interval(group.alive[:, kept], group.runs, rng, how),
        working=_working(group, kept, rng, how),
        final_hold=mean_interval(group.final_hold[rows], group.runs[rows], rng, how),
        verdict=judge(group, rng, how),
    )


def _working(group: Group, kept: IntArray, rng: np.random.Generator, how: Bootstrap) -> Interval:
    """Return the Kaplan-Meier curve over all lanes; the interval is that of the share of failed lanes.

    Both agree until the first lane is cut or can no longer be judged; from then on there is no interval.
    """
    unfailed = ~group.failed & (np.array(group.verdicts) != "never worked")
    without = unfailed[:, None] | (group.failed_steps[:, None] > group.steps[None, kept])
    without &= (np.array(group.verdicts) != "never worked")[:, None]
    interval = survival_interval(without, group.runs, rng, how)
    cut = np.array(group.verdicts) == "cannot tell"
    watched = np.where(cut, group.failed_steps, group.steps[-1] + 1).min()
    bounds = [np.where(group.steps[kept] < watched, bound, np.nan) for bound in (interval.lower, interval.upper)]
    return replace(interval, estimate=group.working[kept], lower=bounds[0], upper=bounds[1])


def thin(steps: IntArray, most: int) -> IntArray:
    """Choose at most `most` recorded steps, half evenly on a log scale and half on a linear one, ends included.

    Args:
        steps: Rising positive steps, shape (n,).
        most: At least 2.

    Returns:
        Indices into `steps`, rising.
    """
    if len(steps) <= most:
        return np.arange(len(steps))
    half = most // 2
    wanted = np.concatenate([np.geomspace(steps[0], steps[-1], most - half), np.linspace(steps[0], steps[-1], half)])
    after = np.clip(np.searchsorted(steps, wanted), 1, len(steps) - 1)
    nearer = after - (wanted - steps[after - 1] < steps[after] - wanted)
    return np.unique(nearer)
