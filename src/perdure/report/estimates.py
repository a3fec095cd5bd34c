"""What is estimated about a group, once, for the figures, the table and the verdict alike."""

from __future__ import annotations

from dataclasses import dataclass

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

MOST_POINTS = 80
"""Checkpoints drawn per curve; a table may hold many more."""


@dataclass(frozen=True)
class Estimate:
    """A group with its means and intervals."""

    group: Group
    steps: IntArray
    """The checkpoints kept, shape (points,); the last one is the table's last."""
    returns: Interval
    """Mean cumulative return, shape (points,)."""
    return_units: FloatArray
    """Of the units of these intervals, shape (units, points)."""
    survival: Interval
    """Share of lanes alive, shape (points,)."""
    first_tenth: Interval
    """Mean reward per step in the first tenth, shape ()."""
    last_tenth: Interval

    @property
    def final_return(self) -> float:
        """Mean return at the last checkpoint."""
        return float(self.returns.estimate[-1])


def estimate_group(group: Group, rng: np.random.Generator, how: Bootstrap = DEFAULT) -> Estimate:
    """Estimate a group: lanes averaged within training runs, intervals over runs (see `statistics`)."""
    kept = thin(group.steps, MOST_POINTS)
    known = np.isfinite(group.first_tenth) & np.isfinite(group.last_tenth)
    # A tenth that nobody knows yet is nan for all lanes; then the estimate is nan too.
    rows = known if known.any() else np.ones_like(known)
    units = make_units(group.returns[:, kept], group.runs)
    return Estimate(
        group=group,
        steps=group.steps[kept],
        returns=estimate_interval(units, rng, how),
        return_units=units.values,
        survival=survival_interval(group.alive[:, kept], group.runs, rng, how),
        first_tenth=mean_interval(group.first_tenth[rows], group.runs[rows], rng, how),
        last_tenth=mean_interval(group.last_tenth[rows], group.runs[rows], rng, how),
    )


def thin(steps: IntArray, most: int) -> IntArray:
    """Choose at most `most` checkpoints, half evenly on a log scale and half on a linear one, ends included.

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
