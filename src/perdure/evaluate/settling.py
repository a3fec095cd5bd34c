"""When a reference settles: the steps in which a policy is still on its way to what it does from then on.

A pendulum first swings up and is then upright. A rate over whole reference episodes mixes the two, and a policy that
never gets upright compares well with it. The settling time therefore comes from the reference episodes: it is the
truncation point of their mean reward, by the rule MSER-m (marginal standard error rule) of simulation output analysis
[White, 1997, Simulation 69(6); compared with others in Hoad, Robinson and Davies, 2010, Journal of the Operational
Research Society 61]:

    d = argmin over d <= n / 2 of  variance(y[d:]) / (n - d)

y: the mean reward of the episodes in each of n bins of m = `BIN_STEPS` steps.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from perdure.policy.reference import BIN_STEPS, Reference

SETTLING = 0.1
"""Least share of the training horizon left out of the reference: the start from rest, and rewards paid only there."""
TOLERANCE = 0.05
"""More is left out where the rate would otherwise differ from the settled one by more than this share of the largest
difference on the way."""
FEWEST_BINS = 4
"""Bins that the rule needs."""
ARRIVED = 0.25
"""The way ends with the first bin whose loss is at most this share of the largest loss on it."""
PAID_ONCE = 0.5
"""A bonus: the largest bin has this share of what an episode earned on its way above the settled rate."""


@dataclass(frozen=True)
class Settling:
    """How the reference episodes of a policy begin."""

    steps: int
    """Steps that the reference leaves out; 0 where most episodes end before."""
    way_rate: float = math.nan
    """Reward per step before it arrived, if that takes longer than `SETTLING` of the horizon; else nan."""


def settle(reference: Reference, error: Callable[[int], float]) -> Settling:
    """Return how reference episodes begin.

    Args:
        reference: Episodes within the training horizon.
        error: Steps left out to the differences of the rate that may be chance.
    """
    first = math.ceil(SETTLING * reference.horizon / BIN_STEPS)
    if not _keeps_most(reference, first):
        return Settling(0)
    curve = _mean_curve(reference)
    if len(curve) < max(FEWEST_BINS, first + 1):
        return Settling(first * BIN_STEPS)
    cut = _mser(curve)
    if cut <= first:
        return Settling(first * BIN_STEPS)
    steady = float(curve[cut:].mean())
    way_rate = _way_rate(curve, cut, steady, first)

    # What falls from the start on is what the policy does, unless it is a bonus for arriving.
    largest = float(np.abs(curve[:cut] - steady).max())
    close = max(TOLERANCE * largest, error(first * BIN_STEPS))
    if curve[first:].mean() > steady + close and not _paid_once(reference, cut, steady):
        return Settling(first * BIN_STEPS, way_rate)

    # No more is left out than makes a difference.
    skip = first
    while skip < cut and abs(curve[skip:].mean() - steady) > close and _keeps_most(reference, skip + 1):
        skip += 1
    return Settling(skip * BIN_STEPS, way_rate)


def _mean_curve(reference: Reference) -> NDArray[np.float64]:
    """Return the mean reward per step of each bin, as long as half of the episodes last, shape (bins,)."""
    whole = reference.lengths // BIN_STEPS
    lasts = np.arange(reference.rewards.shape[1]) < whole[:, None]
    count = lasts.sum(axis=0)
    bins = int((2 * count >= len(whole)).sum())
    earned = np.where(lasts, reference.rewards, 0.0).sum(axis=0)
    curve: NDArray[np.float64] = earned[:bins] / (np.maximum(count[:bins], 1) * BIN_STEPS)
    return curve


def _mser(curve: NDArray[np.float64]) -> int:
    """Return the bins to leave out by MSER, half of them at most."""
    errors = [curve[cut:].var() / (len(curve) - cut) for cut in range(len(curve) // 2 + 1)]
    return int(np.argmin(errors))


def _way_rate(curve: NDArray[np.float64], cut: int, steady: float, first: int) -> float:
    """Return the reward per step before the policy arrives; nan where it does so within the first tenth."""
    largest_loss = steady - float(curve[:cut].min())
    arrival = int(np.argmax(curve >= steady - ARRIVED * largest_loss))
    if arrival <= first or largest_loss <= 0.0:
        return math.nan
    return float(curve[:arrival].mean())


def _paid_once(reference: Reference, cut: int, steady: float) -> bool:
    """Return whether most episodes earned what they earned above the settled rate in one bin."""
    above = np.maximum(reference.rewards[:, :cut] - steady * BIN_STEPS, 0.0)
    total = above.sum(axis=1)
    return bool(np.median(above.max(axis=1) / np.maximum(total, 1e-300)) >= PAID_ONCE)


def _keeps_most(reference: Reference, skip: int) -> bool:
    """Return whether half of the steps of the reference come after these bins."""
    left = np.maximum(reference.lengths - skip * BIN_STEPS, 0)
    return bool(2 * left.sum() >= reference.lengths.sum())
