"""Compare the critic's predictions with observed returns (thesis, 3.2.3: variance of the value estimates).

The return to go of a step is what the critic was trained to predict: the sum of rewards up to the lane's horizon where
its end counts as terminated, the discounted sum without an end where it is bootstrapped. With gamma = 1 and a
bootstrap the value is determined only up to a constant, so there is nothing to compare.

    value error     root mean square of (return to go - value) / standard deviation of the returns to go
    value variance  variance of (return to go - value) / variance of the returns to go; 0: all explained

The critic was trained on the noisy policy and is tested on its mean.
"""

from __future__ import annotations

import math

import numpy as np
import polars as pl
from numpy.typing import NDArray

from perdure.policy import Policy
from perdure.studies.horizon.mechanism_rewards import bins_to_go
from perdure.studies.horizon.rollouts import FloatArray, Rollout

MOST_TAIL = 1000
"""Steps after the horizon that a discounted return to go counts at most."""
FORGOTTEN = 0.01
"""A reward this strongly discounted is left out."""
FEWEST_STATES = 2


def has_target(policy: Policy) -> bool:
    """Return whether the value of a policy means a return that can be measured."""
    anchored = policy.protocol.end == "terminated" or policy.protocol.gamma < 1.0
    return anchored and policy.has_critic and policy.return_scale is not None


def tail_steps(policy: Policy) -> int:
    """Return how many steps after the horizon a rollout needs."""
    protocol = policy.protocol
    if protocol.end == "terminated" or not 0.0 < protocol.gamma < 1.0:
        return 0
    return min(MOST_TAIL, math.ceil(math.log(FORGOTTEN) / math.log(protocol.gamma)))


def returns_to_go(policy: Policy, rollout: Rollout, horizons: NDArray[np.int64]) -> FloatArray:
    """Return what was earned from each step on, shape (m, n)."""
    rewards = rollout.rewards
    if policy.protocol.end == "terminated":
        rewards = np.where(np.arange(len(rewards))[:, None] < horizons[None, :], rewards, 0.0)
    found, following = np.empty_like(rewards), np.zeros(rewards.shape[1])
    for step in range(len(rewards) - 1, -1, -1):
        following = rewards[step] + policy.protocol.gamma * following
        found[step] = following
    return found


def values_to_go(policy: Policy, rollout: Rollout, horizons: NDArray[np.int64]) -> pl.DataFrame:
    """Return mean and spread of values and returns to go in each bin of steps to go; no rows without a target."""
    schema = {
        "steps to go": pl.Int64,
        **dict.fromkeys(("value", "value spread", "return to go", "return spread", "error"), pl.Float64),
    }
    if not has_target(policy):
        return pl.DataFrame(schema=schema)
    bins, values, returns = _states(policy, rollout, horizons)
    frame = pl.DataFrame({"steps to go": bins, "v": values, "g": returns})
    difference = pl.col("g") - pl.col("v")
    return (
        frame.group_by("steps to go")
        .agg(
            pl.col("v").mean().alias("value"),
            pl.col("v").std(ddof=0).alias("value spread"),
            pl.col("g").mean().alias("return to go"),
            pl.col("g").std(ddof=0).alias("return spread"),
            difference.pow(2).mean().sqrt().alias("error"),
        )
        .sort("steps to go")
    )


def value_measures(policy: Policy, rollout: Rollout, horizons: NDArray[np.int64]) -> dict[str, float]:
    """Return "value error" and "value variance"; nothing without a target."""
    if not has_target(policy):
        return {}
    _, values, returns = _states(policy, rollout, horizons)
    spread = float(returns.std()) if len(returns) >= FEWEST_STATES else 0.0
    if spread == 0.0:
        return {}
    difference = returns - values
    error = math.sqrt(float((difference**2).mean())) / spread
    return {"value error": error, "value variance": float(difference.var()) / spread**2}


def _states(
    policy: Policy, rollout: Rollout, horizons: NDArray[np.int64]
) -> tuple[NDArray[np.int64], FloatArray, FloatArray]:
    """Return (bin, value, return to go) of every state within its horizon, shape (states,) each."""
    bins = bins_to_go(rollout, horizons)
    within = bins > 0
    elapsed = np.broadcast_to(np.arange(len(bins), dtype=np.float64)[:, None], bins.shape)[within]
    horizon = np.broadcast_to(horizons.astype(np.float64)[None, :], bins.shape)[within]
    values = policy.value(rollout.observations[within], elapsed, horizon)
    return bins[within], values, returns_to_go(policy, rollout, horizons)[within]
