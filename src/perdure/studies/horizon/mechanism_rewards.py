"""Reward and falls against the steps to go of the training horizon (thesis, 3.5.1: robots lurch forward at the end)."""

from __future__ import annotations

import numpy as np
import polars as pl
from numpy.typing import NDArray

from perdure.studies.horizon.rollouts import Rollout

BIN = 50
"""Steps to go that are counted together; the bin 50 holds 1 to 50."""


def bins_to_go(rollout: Rollout, horizons: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the bin of each step that was made within its lane's horizon, 0 for all others; shape (m, n)."""
    left = horizons[None, :] - np.arange(len(rollout.rewards))[:, None]
    bins: NDArray[np.int64] = np.where(rollout.made & (left > 0), -(-left // BIN) * BIN, 0)
    return bins


def rewards_to_go(rollout: Rollout, horizons: NDArray[np.int64]) -> pl.DataFrame:
    """Return reward per step, steps and falls in each bin: "steps to go", "reward", "steps", "falls"."""
    bins = bins_to_go(rollout, horizons)
    fell = np.zeros(bins.shape)
    for lane in np.flatnonzero(rollout.fell):
        fell[rollout.lengths[lane] - 1, lane] = 1.0
    frame = pl.DataFrame({"steps to go": bins.ravel(), "reward": rollout.rewards.ravel(), "falls": fell.ravel()})
    within = frame.filter(pl.col("steps to go") > 0)
    return (
        within.group_by("steps to go")
        .agg(pl.col("reward").mean(), steps=pl.len().cast(pl.Int64), falls=pl.col("falls").sum().cast(pl.Int64))
        .sort("steps to go")
    )


def fall_rate(rollout: Rollout, horizons: NDArray[np.int64]) -> float:
    """Return falls for each 1,000 steps within the horizon."""
    within = np.minimum(rollout.lengths, horizons)
    falls = (rollout.fell & (rollout.lengths <= horizons)).sum()
    return float(1000.0 * falls / within.sum())
