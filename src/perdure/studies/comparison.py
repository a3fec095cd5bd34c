"""Differences between groups of training runs: interval, p value, probability of improvement, Holm's correction."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

CONFIDENCE = 0.95
FEWEST = 2
"""Runs that an interval needs on each side."""

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Difference:
    """Left minus right, over training runs."""

    left: float
    right: float
    """Means of the two sides."""
    error: float
    """Standard error of the difference; nan where there are too few runs."""
    freedom: float
    """Degrees of freedom of Student's t."""
    improvement: float
    """Share of pairs of runs in which left is greater; ties count half."""
    n_left: int
    n_right: int
    """Runs on each side; 0: the right side is a number."""
    method: str
    """"paired t", "Welch t" or "Student t" (against a number)."""
    rank_p: float
    """Two-sided p of the sign test or the permutation test where no side has any spread."""

    @property
    def estimate(self) -> float:
        """Left minus right."""
        return self.left - self.right

    @property
    def half(self) -> float:
        """Half the width of the 95 % interval; nan where there are too few runs."""
        if not self.error > 0.0:
            return self.error
        from scipy.special import stdtrit

        return float(stdtrit(self.freedom, 0.5 + CONFIDENCE / 2.0)) * self.error

    @property
    def lower(self) -> float:
        """Of the 95 % interval; nan where there are too few runs."""
        return self.estimate - self.half

    @property
    def upper(self) -> float:
        """Likewise."""
        return self.estimate + self.half

    def p(self, threshold: float = 0.0) -> float:
        """Return the two-sided p value of the difference being this; nan where there are too few runs."""
        away = abs(self.estimate - threshold)
        if not self.error > 0.0:
            return math.nan if math.isnan(self.error) else self.rank_p if away > 0.0 else 1.0
        from scipy.special import stdtr

        return 2.0 * float(stdtr(self.freedom, -away / self.error))

    @property
    def count(self) -> str:
        """How many runs there are, such as "10" or "5 against 10"."""
        one = self.n_right in (0, self.n_left)
        return str(self.n_left) if one else f"{self.n_left} against {self.n_right}"


def compare_paired(left: Mapping[int, float], right: Mapping[int, float]) -> Difference:
    """Compare two deployments of the same training runs, by the differences within runs; keys are training seeds."""
    seeds = sorted(set(left) & set(right))
    a, b = (np.array([side[seed] for seed in seeds], np.float64) for side in (left, right))
    error, freedom = _student(a - b)
    wins = float(np.mean((a > b) + 0.5 * (a == b))) if seeds else math.nan
    return _difference(a, b, len(b), error, freedom, "paired t", wins, 2.0 * 0.5 ** len(a))


def compare_unpaired(left: Sequence[float], right: Sequence[float]) -> Difference:
    """Compare two groups of training runs that have nothing in common, by Welch's t interval."""
    a, b = np.asarray(left, np.float64), np.asarray(right, np.float64)
    error, freedom = _welch(a, b)
    wins = (a[:, None] > b[None, :]) + 0.5 * (a[:, None] == b[None, :])
    improvement = float(wins.mean()) if wins.size else math.nan
    return _difference(a, b, len(b), error, freedom, "Welch t", improvement, 2.0 / math.comb(len(a) + len(b), len(a)))


def compare_with(left: Sequence[float], value: float) -> Difference:
    """Compare a group of training runs with a number, by Student's t interval."""
    a = np.asarray(left, np.float64)
    error, freedom = _student(a - value)
    wins = float(np.mean(a > value)) if a.size else math.nan
    return _difference(a, np.array([value]), 0, error, freedom, "Student t", wins, 2.0 * 0.5 ** len(a))


def holm(p_values: Sequence[float]) -> list[float]:
    """Adjust p values for their number by Holm's step-down method [Holm, 1979, Scand. J. Statist. 6].

    nan, a comparison that is not there yet, stays nan and counts: what is decided now stays decided when it comes.
    """
    known = [k for k, p in enumerate(p_values) if math.isfinite(p)]
    adjusted = [math.nan] * len(p_values)
    running = 0.0
    for rank, k in enumerate(sorted(known, key=lambda k: p_values[k])):
        running = max(running, min(1.0, (len(p_values) - rank) * p_values[k]))
        adjusted[k] = running
    return adjusted


def _difference(
    a: FloatArray,
    b: FloatArray,
    n_right: int,
    error: float,
    freedom: float,
    method: str,
    improvement: float,
    rank_p: float,
) -> Difference:
    left, right = (float(side.mean()) if side.size else math.nan for side in (a, b))
    return Difference(left, right, error, freedom, improvement, len(a), n_right, method, min(1.0, rank_p))


def _student(values: FloatArray) -> tuple[float, float]:
    """Return the standard error of the mean, and its degrees of freedom."""
    n = len(values)
    if n < FEWEST or not np.isfinite(values).all():
        return math.nan, math.nan
    return float(values.std(ddof=1)) / math.sqrt(n), n - 1.0


def _welch(a: FloatArray, b: FloatArray) -> tuple[float, float]:
    """Return the standard error of the difference of two means, and Welch's degrees of freedom."""
    n, m = len(a), len(b)
    if min(n, m) < FEWEST or not (np.isfinite(a).all() and np.isfinite(b).all()):
        return math.nan, math.nan
    first, second = float(a.var(ddof=1)) / n, float(b.var(ddof=1)) / m
    squared = first + second
    if squared == 0.0:
        return 0.0, math.nan
    return math.sqrt(squared), squared**2 / (first**2 / (n - 1) + second**2 / (m - 1))
