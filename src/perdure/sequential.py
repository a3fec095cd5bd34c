"""Intervals for a mean difference that stay valid however early one stops: pairs are added until they decide.

The test is a betting game [Waudby-Smith and Ramdas, 2024, "Estimating means of bounded random variables by betting",
Journal of the Royal Statistical Society B 86(1)]. A bettor claims that the mean difference is above m, and bets on each
pair. If the claim is wrong, the chance that the bettor's wealth ever grows to 40 times its start is at most 1 / 40
(Ville's inequality). Such wealth therefore shows that the mean is above m, with an error of at most 2.5 %, and it may
be looked at after every pair. The interval holds every m that neither side has refuted: both sides together are wrong
in at most 5 % of comparisons.

Differences must be bounded. Neither a normal distribution nor symmetry is assumed, so many small gains do not hide a
rare large loss. The wealth is spread evenly over `BETS`, from cautious to bold ones. The result depends on the
differences, not on their order. Errors are ValueErrors.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from perdure.stats import CONFIDENCE, FloatArray

__all__ = ["betting_interval", "log_wealth", "pairs_until_decided"]

BETS: FloatArray = np.linspace(0.05, 0.99, 20)
"""Stakes, as shares of the largest one that cannot lose more than the wealth."""
BISECTIONS = 40
"""Halvings of the range in which a bound is searched."""
MOST_FACTOR = 1e4
"""Most times the pairs seen, up to which the number of pairs that would decide is predicted."""


def log_wealth(differences: ArrayLike, span: float, mean: float = 0.0) -> float:
    """Return the logarithm of the wealth of a bettor who claims that the mean difference is above `mean`; 0 at first.

    Args:
        differences: Each between -span and span, shape (pairs,).
        span: Largest difference that is possible.
        mean: Between -span and span.

    Raises:
        ValueError: A difference lies outside, or is not finite.
    """
    values = _checked(differences, span)
    if mean >= span:
        return -math.inf  # no mean lies above the largest difference
    return _log_mean(_log_products(values, span, mean))


def betting_interval(differences: ArrayLike, span: float, confidence: float = CONFIDENCE) -> tuple[float, float]:
    """Return the bounds of the mean difference, valid after any number of pairs; arguments as of `log_wealth`.

    Without a pair they are -span and span.
    """
    values = _checked(differences, span)
    lower = _lower_bound(values, span, confidence)
    upper = -_lower_bound(-values, span, confidence)
    return lower, upper


def pairs_until_decided(differences: ArrayLike, span: float, confidence: float = CONFIDENCE) -> float:
    """Return how many pairs decide in all, if those to come are like those seen; inf where no number would.

    It is a forecast, not part of the test: by chance, the pairs seen may look better or worse than those to come.
    """
    values = _checked(differences, span)
    count = len(values)
    if not count:
        return math.inf
    needed = _winning(confidence)
    products = _log_products(values, span, 0.0)
    if _log_mean(_log_products(-values, span, 0.0)) > _log_mean(products):
        products = _log_products(-values, span, 0.0)
    if _log_mean(MOST_FACTOR * products) < needed:
        return math.inf
    # The wealth after the same differences were seen `factor` times rises with the factor once it is above 1.
    low = 0.0
    high = MOST_FACTOR
    for _ in range(BISECTIONS):
        middle = (low + high) / 2.0
        if _log_mean(middle * products) < needed:
            low = middle
        else:
            high = middle
    return math.ceil(count * high)


def _lower_bound(values: FloatArray, span: float, confidence: float) -> float:
    """Return the largest m for which the claim that the mean is above m has won; -span if there is none."""
    needed = _winning(confidence)
    low = -span
    high = span
    for _ in range(BISECTIONS):
        middle = (low + high) / 2.0
        # The wealth falls as m rises, whatever the differences are.
        if _log_mean(_log_products(values, span, middle)) >= needed:
            low = middle
        else:
            high = middle
    return low


def _winning(confidence: float) -> float:
    """Return the logarithm of the wealth that decides: half of the error belongs to each side."""
    return math.log(2.0 / (1.0 - confidence))


def _log_products(values: FloatArray, span: float, mean: float) -> FloatArray:
    """Return the logarithm of what each bet has made of its wealth, shape (bets,)."""
    gains = (values - mean) / (span + mean)  # at least -1: a bet never loses more than it put in
    products: FloatArray = np.log1p(BETS[:, None] * gains).sum(axis=1)
    return products


def _log_mean(logarithms: FloatArray) -> float:
    """Return the logarithm of the mean of numbers given by their logarithms."""
    largest = float(logarithms.max())
    return largest + math.log(float(np.exp(logarithms - largest).mean()))


def _checked(differences: ArrayLike, span: float) -> FloatArray:
    values = np.asarray(differences, np.float64)
    if values.ndim != 1 or not (np.abs(values) <= span * (1.0 + 1e-12)).all():
        raise ValueError(f"differences must be numbers between {-span:g} and {span:g}, shape (pairs,)")
    return np.clip(values, -span, span)
