"""Differences between groups of training runs: interval, p values, probability of improvement, Holm's correction."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from perdure.report.statistics import rng_keyword

CONFIDENCE = 0.95
FEWEST = 2
"""Runs that an interval needs on each side."""
PERMUTATIONS = 200_000
"""Of a permutation test. It is exact where there are no more, as of 10 runs against 10, or of 17 pairs."""

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
    """Share of pairs of runs (of runs, where paired or beside a number) in which left is greater; ties count half."""
    n_left: int
    n_right: int
    """Runs on each side; 0: the right side is a number."""
    method: str
    """"paired t", "Welch t" or "Student t" (against a number)."""
    samples: tuple[tuple[float, ...], ...] = ()
    """What a permutation test permutes: the two sides, or one sample of differences; () where there is no such test."""

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
        """Return the two-sided p value of the difference being this, by Student's t; nan where there are too few runs.

        Runs without any spread have the p value of the permutation test.
        """
        if math.isnan(self.error):
            return math.nan
        if self.error == 0.0:
            return self.permutation_p(threshold)
        from scipy.special import stdtr

        return 2.0 * float(stdtr(self.freedom, -abs(self.estimate - threshold) / self.error))

    def permutation_p(self, threshold: float = 0.0) -> float:
        """Return the same by a permutation test of the difference of means; nan where there are too few runs.

        Two groups are permuted after the threshold is taken from the left side, which assumes that they differ by a
        shift. One group, of differences, has its signs flipped, which assumes that it is symmetric [Ernst, 2004,
        "Permutation Methods: A Basis for Exact Inference"].
        """
        if not self.samples or math.isnan(self.error):
            return math.nan
        from scipy.stats import permutation_test

        first, *others = (np.array(each) for each in self.samples)
        data = (first - threshold, *others)
        kind = "independent" if others else "samples"
        settings = {"n_resamples": PERMUTATIONS, rng_keyword(permutation_test): 0}
        found = permutation_test(data, _difference_of_means, vectorized=True, permutation_type=kind, **settings)
        return float(found.pvalue)

    @property
    def least_permutation_p(self) -> float:
        """The least p value that an exact permutation test of so many runs can give; nan where there is none."""
        if not self.samples or math.isnan(self.error):
            return math.nan
        if len(self.samples) == 1:
            return 2.0 / 2.0**self.n_left
        return 2.0 / math.comb(self.n_left + self.n_right, self.n_left)

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
    return _difference(a, b, len(b), error, freedom, "paired t", wins, (a - b,))


def compare_unpaired(left: Sequence[float], right: Sequence[float]) -> Difference:
    """Compare two groups of training runs that have nothing in common, by Welch's t interval."""
    a, b = np.asarray(left, np.float64), np.asarray(right, np.float64)
    error, freedom = _welch(a, b)
    wins = (a[:, None] > b[None, :]) + 0.5 * (a[:, None] == b[None, :])
    improvement = float(wins.mean()) if wins.size else math.nan
    return _difference(a, b, len(b), error, freedom, "Welch t", improvement, (a, b))


def compare_with(left: Sequence[float], value: float) -> Difference:
    """Compare a group of training runs with a number, by Student's t interval."""
    a = np.asarray(left, np.float64)
    error, freedom = _student(a - value)
    wins = float(np.mean((a > value) + 0.5 * (a == value))) if a.size else math.nan
    return _difference(a, np.array([value]), 0, error, freedom, "Student t", wins, (a - value,))


def mean_difference(differences: Sequence[Difference], scales: Sequence[float] | None = None) -> Difference:
    """Return the mean of independent differences, with Satterthwaite's degrees of freedom [1946, Biometrics 2].

    Args:
        differences: Such as one for each task; at least one.
        scales: What each is divided by first, taken as exact; 1 by default.
    """
    k, by = len(differences), [1.0] * len(differences) if scales is None else scales
    parts = [(each.error / scale / k) ** 2 for each, scale in zip(differences, by, strict=True)]
    squared = sum(parts)
    terms = [part**2 / each.freedom for part, each in zip(parts, differences, strict=True) if part > 0.0]
    return Difference(
        left=sum(each.estimate / scale for each, scale in zip(differences, by, strict=True)) / k,
        right=0.0,
        error=math.sqrt(squared),
        freedom=squared**2 / sum(terms) if terms else math.nan,
        improvement=sum(each.improvement for each in differences) / k,
        n_left=min(each.n_left for each in differences),
        n_right=min(each.n_right for each in differences),
        method=f"mean of {k} tasks",
    )


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
    samples: Sequence[FloatArray],
) -> Difference:
    left, right = (float(side.mean()) if side.size else math.nan for side in (a, b))
    kept = tuple(tuple(each.tolist()) for each in samples)
    return Difference(left, right, error, freedom, improvement, len(a), n_right, method, kept)


def _difference_of_means(a: FloatArray, b: FloatArray | None = None, axis: int = -1) -> FloatArray:
    """Return the mean of one group, or the difference of the means of two."""
    return np.asarray(a.mean(axis) if b is None else a.mean(axis) - b.mean(axis))


def _student(values: FloatArray) -> tuple[float, float]:
    """Return the standard error of the mean, and its degrees of freedom."""
    n = len(values)
    if n < FEWEST or not np.isfinite(values).all():
        return math.nan, math.nan
    if np.ptp(values) == 0.0:  # the standard deviation of equal numbers is not always 0
        return 0.0, math.nan
    return float(values.std(ddof=1)) / math.sqrt(n), n - 1.0


def _welch(a: FloatArray, b: FloatArray) -> tuple[float, float]:
    """Return the standard error of the difference of two means, and Welch's degrees of freedom."""
    n, m = len(a), len(b)
    if min(n, m) < FEWEST or not (np.isfinite(a).all() and np.isfinite(b).all()):
        return math.nan, math.nan
    if np.ptp(a) == np.ptp(b) == 0.0:
        return 0.0, math.nan
    first, second = float(a.var(ddof=1)) / n, float(b.var(ddof=1)) / m
    squared = first + second
    return math.sqrt(squared), squared**2 / (first**2 / (n - 1) + second**2 / (m - 1))
