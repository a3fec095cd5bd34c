"""Summarize logs as rows of the table: success, stages, failures and paired differences."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import polars as pl

from perdure.home.errors import HomeError
from perdure.home.evaluate.outcomes import COUNTINGS, Analysis, paired_difference
from perdure.home.evaluate.outcomes.differences import SAME_PLACEMENT
from perdure.home.evaluate.page import PolicyAssignment
from perdure.home.evaluate.page.comparison import Comparison, comparisons
from perdure.studies.placement.names import WORLDS
from perdure.studies.placement.results import Results, Row
from perdure.studies.placement.schema import RELEASE

BOUNDS = ("estimate", "lower", "upper")
PAIRS = (("rl", "stop"), ("rl", "ik"), ("stop", "ik"), ("ik", "ik+"), ("rl", "delta-200"))
"""Strategies that are compared over the same episodes: (first, second), second minus first."""
SUCCEEDED = {"latched": "success", "stabilizing": "stabilizing"}
"""Way of counting to its column of the episodes' table."""


def with_logs(results: Results, analysis: Analysis, assignment: PolicyAssignment) -> Results:
    """Return results in which rows of logs replace rows about the same; all others stay."""
    compared = comparisons(analysis)
    rows = [strategy_row(each, strategy, assignment) for each in compared for strategy in each.strategies]
    return results.merge(assignment.commands, rows, [pair for each in compared for pair in pairs(each)])


def strategy_row(comparison: Comparison, strategy: str, assignment: PolicyAssignment) -> Row:
    """Return one row: a task, a split, a release strategy in a world."""
    episodes = comparison.episodes[strategy]
    subject = comparison.task, comparison.split, strategy
    return {
        "task": comparison.task,
        "split": comparison.split,
        "strategy": strategy,
        "episodes": len(episodes),
        "seeds": {name: episodes[f"{name}_seed"].n_unique() for name in ("train", "eval")},
        **{counting: _success(comparison, strategy, counting) for counting in COUNTINGS},
        "stages": {
            counting: {
                row["stage"]: round(row["mean"], 4)
                for row in comparison.stages[strategy].filter(counting=counting).iter_rows(named=True)
            }
            for counting in COUNTINGS
        },
        "kinds": _kinds(comparison, strategy),
        **_failures(comparison, strategy),
        "hand_overs": dict(assignment.hand_overs.get(subject, {})),
    }


def _success(comparison: Comparison, strategy: str, counting: Any) -> Row:
    final, column = comparison.final(strategy, counting), SUCCEEDED[counting]
    by_seed = comparison.episodes[strategy].group_by("train_seed").agg(pl.col(column).mean()).sort("train_seed")
    return {
        **{key: round(float(final[key]), 4) for key in ("mean", "standard_error", "lower", "upper")},
        "method": final["method"],
        "train_seeds": [round(share, 4) for share in by_seed[column]],
    }


def _kinds(comparison: Comparison, strategy: str) -> Row:
    placed = comparison.placements[strategy]
    return {
        row["kind"]: {
            "placements": row["placements"],
            "not_stable": row["failures"],
            "median_at_release": _medians(placed.filter(kind=row["kind"])),
        }
        for row in comparison.kinds[strategy].iter_rows(named=True)
    }


def _medians(placements: pl.DataFrame) -> dict[str, float]:
    return {name: round(float(np.median(placements[name].to_numpy())), 3) for name in RELEASE}


def _failures(comparison: Comparison, strategy: str) -> Row:
    episodes = comparison.episodes[strategy]
    outcomes = {row["outcome"]: row["count"] for row in comparison.outcomes[strategy].iter_rows(named=True)}
    return {
        "failed": len(episodes) - int(episodes["success"].sum()),
        "failed_at": {name: count for name, count in outcomes.items() if name.startswith("place_")},
        "did_not_last": outcomes["success that did not last"],
        "modes": {
            f"{row['stage']}, {row['cause']}": row["count"]
            for row in comparison.modes[strategy].filter(counting="stabilizing").iter_rows(named=True)
        },
    }


def pairs(comparison: Comparison) -> Iterator[Row]:
    """Yield the paired difference of every two strategies of `PAIRS` that ran in the same world."""
    for world in WORLDS:
        for first, second in PAIRS:
            names = [" ".join(filter(None, (strategy, world))) for strategy in (first, second)]
            if not set(names) <= set(comparison.strategies):
                continue
            before, after = names
            try:
                found = paired_difference(comparison.episodes[before], comparison.episodes[after])
                stayed = paired_difference(
                    comparison.placements[before], comparison.placements[after], keys=SAME_PLACEMENT
                )
            except HomeError:  # they share no episode or no placement
                continue
            yield {
                "task": comparison.task,
                "split": comparison.split,
                "strategy": f"{second} - {first}" + (f" {world}" if world else ""),
                "world": world,
                "first": first,
                "second": second,
                **{key: round(float(getattr(found, key)), 4) for key in BOUNDS},
                "placements": {key: round(float(getattr(stayed, key)), 4) for key in BOUNDS},
                "units": found.count,
                "method": found.method,
            }
