"""Two release strategies on the same episodes: the paired difference in success, with an interval."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from perdure.home.errors import HomeError
from perdure.report.statistics import Interval, estimate_interval, make_units

if TYPE_CHECKING:
    import polars as pl

SAME_EPISODE = ("train_seed", "eval_seed", "index", "episode_hash")
SAME_PLACEMENT = (*SAME_EPISODE, "target")


def paired_difference(
    first: pl.DataFrame, second: pl.DataFrame, column: str = "stabilizing", keys: tuple[str, ...] = SAME_EPISODE
) -> Interval:
    """Return the mean difference in success, second minus first, over the episodes that both ran.

    Episodes are paired by training seed, evaluation seed, number and hash: the same start and goals. The differences
    are averaged within a training seed; training seeds are the units of the 95 % interval. With one training seed the
    episodes are, and the interval says nothing about training again.

    Args:
        first: Rows of `Analysis.episodes` of one release strategy, or of `Analysis.placements`.
        second: Of the other, in the same task and split.
        column: `stabilizing`, or `success` (latched) of episodes.
        keys: What makes a pair: `SAME_EPISODE`, or `SAME_PLACEMENT` for placements of the same object.

    Raises:
        HomeError: If the two have no pair.
    """
    import polars as pl

    both = first.select(*keys, pl.col(column).alias("first")).join(
        second.select(*keys, pl.col(column).alias("second")), on=keys
    )
    if both.is_empty():
        raise HomeError("the two release strategies have no episode of equal training and evaluation seed in common")
    change = both["second"].cast(pl.Float64) - both["first"].cast(pl.Float64)
    units = make_units(change.to_numpy(), both["train_seed"].to_numpy())
    found = estimate_interval(units, np.random.default_rng(0))
    return replace(found, lower=np.clip(found.lower, -1.0, 1.0), upper=np.clip(found.upper, -1.0, 1.0))
