"""Whether the hand obstructs what it has placed (thesis, section 2.4): touches after the release, by kind of object."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from perdure.home.evaluate.analysis import GROUP, analyze
from perdure.home.evaluate.log import EpisodeLog
from perdure.stats import clopper_pearson

if TYPE_CHECKING:
    import polars as pl

PUSHED = 0.01
"""Way in [m] from which on the hand has moved an object that it has released (our choice)."""


def touch_table(logs: Sequence[EpisodeLog]) -> pl.DataFrame:
    """Return how often the hand touches and moves an object within two seconds of its release, by kind.

    Only placements of which the logs tell count. Columns after those of the strategy: `kind`, whether it is a
    `cylinder`, number of `placements`, `touched` and `pushed` (by `PUSHED` or more), shares of both with the bounds of
    their 95 % intervals over placements (Clopper-Pearson), and shares of placements that did not stay: `unstable` of
    those that were touched, and of the others.
    """
    import polars as pl

    known = analyze(logs).placements.filter(pl.col("touches") >= 0)
    touched = pl.col("touches") > 0
    table = (
        known.group_by(*GROUP, "kind", "cylinder", maintain_order=True)
        .agg(
            pl.len().cast(pl.Int64).alias("placements"),
            touched.sum().cast(pl.Int64).alias("touched"),
            (pl.col("pushed") >= PUSHED).sum().cast(pl.Int64).alias("pushed"),
            (~pl.col("stabilizing")).filter(touched).mean().alias("touched unstable"),
            (~pl.col("stabilizing")).filter(~touched).mean().alias("untouched unstable"),
        )
        .sort(*GROUP, "kind")
    )
    shares: dict[str, list[float]] = {}
    for name in ("touched", "pushed"):
        for count, placements in table.select(name, "placements").iter_rows():
            lower, upper = clopper_pearson(count / placements, placements)
            for column, value in (("share", count / placements), ("lower", float(lower)), ("upper", float(upper))):
                shares.setdefault(f"{name} {column}", []).append(value)
    return table.with_columns(**{name: pl.Series(values, dtype=pl.Float64) for name, values in shares.items()})
