"""The table of strategies as flat CSV: success of each row, and paired differences."""

from __future__ import annotations

import polars as pl

from perdure.home.evaluate.outcomes import COUNTINGS
from perdure.studies.placement.results import Results, strategy_and_world

BOUNDS = ("mean", "lower", "upper")


def success_frame(results: Results) -> pl.DataFrame:
    """Return one row for each task, split, strategy and world: seeds, success by both ways of counting."""
    return pl.DataFrame(
        [
            {
                "task": row["task"],
                "split": row["split"],
                **dict(zip(("strategy", "world"), strategy_and_world(row), strict=True)),
                "train_seeds": row["seeds"]["train"],
                "eval_seeds": row["seeds"]["eval"],
                "episodes": row["episodes"],
                **{f"{way} {name}": float(row[way][name]) for way in COUNTINGS for name in BOUNDS},
            }
            for row in results.rows
        ]
    )


def difference_frame(results: Results) -> pl.DataFrame:
    """Return one row for each pair of strategies: second minus first, of episodes and of placements."""
    bounds = ("estimate", "lower", "upper")
    return pl.DataFrame(
        [
            {
                **{name: pair[name] for name in ("task", "split", "world", "first", "second", "units", "method")},
                **{f"episodes {name}": float(pair[name]) for name in bounds},
                **{f"placements {name}": float(pair["placements"][name]) for name in bounds},
            }
            for pair in results.pairs
        ]
    )
