"""What the claims about working shares depend on: which runs count as standing, and that slowness costs nothing."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import polars as pl

from studies.disturbance.claims import (
    CALM,
    CLAIMS,
    Claim,
    Sides,
    difference,
    measure_runs,
    resampled_difference,
    run_counts,
    sides_by_task,
)

THRESHOLDS = (0.0, 0.1, 0.25, 0.35, 0.5, 0.6, 0.75)
"""Shares of discounted PPO's calm gain below which a run stands; 0.25 is registered."""
MEASURES = ("working share", "work", "score")
"""Of `measure_runs`: what a disturbed claim can be about; the first is registered."""
DISTURBED_CLAIMS = tuple((number, claim) for number, claim in enumerate(CLAIMS, 1) if claim.condition != CALM)


def threshold_table(episodes: pl.DataFrame) -> pl.DataFrame:
    """Return the effect of each claim about working shares by standing threshold, mean over tasks.

    Args:
        episodes: Rows of the frozen table of fresh runs: a row for each episode.
    """
    rows = []
    for threshold in THRESHOLDS:
        runs = measure_runs(episodes, threshold)
        for number, claim in DISTURBED_CLAIMS:
            sides = sides_by_task(runs, claim)
            rows.append(
                {"threshold": threshold, "claim": number, **_row(claim, ", ".join(sides), list(sides.values()))}
            )
    return pl.DataFrame(rows)


def work_table(episodes: pl.DataFrame) -> pl.DataFrame:
    """Return the effect of each claim about working shares by other measures, on each task and their mean."""
    runs = measure_runs(episodes)
    rows: list[dict[str, Any]] = []
    for number, claim in DISTURBED_CLAIMS:
        for measure in MEASURES:
            for row in _rows_by_task(runs, replace(claim, measure=measure)):
                rows.append({"claim": number, **row})
    return pl.DataFrame(rows)


def _rows_by_task(runs: pl.DataFrame, claim: Claim) -> Iterator[dict[str, Any]]:
    """Yield a row for each task, and one for their mean."""
    sides = sides_by_task(runs, claim)
    for task, pair in sides.items():
        yield _row(claim, task, [pair])
    yield _row(claim, ", ".join(sides), list(sides.values()))


def _row(claim: Claim, task: str, pairs: list[Sides]) -> dict[str, Any]:
    """Return the effect with its 95 % interval (bootstrap over training runs within tasks)."""
    rng = np.random.default_rng(0)  # anew for each row: no interval depends on which others there are
    low, high = np.quantile(resampled_difference(pairs, rng), (0.025, 0.975))
    return {
        "left": claim.left,
        "right": claim.right,
        "condition": claim.condition,
        "measure": claim.measure,
        "task": task,
        "runs": min(run_counts(pairs)),
        "left mean": np.mean([left.mean() for left, _ in pairs]),
        "right mean": np.mean([right.mean() for _, right in pairs]),
        "effect": difference(pairs),
        "low": low,
        "high": high,
    }
