"""Differences agree with SciPy's tests; Holm's method with a worked example."""

import math

import numpy as np
import pytest
from scipy import stats

from perdure.studies.comparison import (
    Difference,
    compare_paired,
    compare_unpaired,
    compare_with,
    holm,
    mean_difference,
)


@pytest.fixture
def groups():
    rng = np.random.default_rng(3)
    return rng.normal(1.0, 1.0, 5), rng.normal(0.0, 3.0, 9)


def test_unpaired_is_welch(groups):
    found, reference = compare_unpaired(*groups), stats.ttest_ind(*groups, equal_var=False)
    interval = reference.confidence_interval(0.95)
    assert (found.lower, found.upper) == pytest.approx((interval.low, interval.high))
    assert found.p() == pytest.approx(reference.pvalue)
    assert found.count == "5 against 9"


def test_paired_is_student_over_differences_of_common_runs(groups):
    left, right = dict(enumerate(groups[0])), dict(enumerate(groups[1]))
    found, reference = compare_paired(left, right), stats.ttest_rel(groups[0], groups[1][:5])
    interval = reference.confidence_interval(0.95)
    assert (found.lower, found.upper) == pytest.approx((interval.low, interval.high))
    assert found.p() == pytest.approx(reference.pvalue)


def test_pairing_narrows_the_interval_of_runs_that_vary_together():
    runs = {seed: 10.0 * seed for seed in range(5)}
    better = {seed: value + 1.0 + 0.01 * seed for seed, value in runs.items()}
    assert compare_paired(better, runs).lower > 0.0
    assert compare_unpaired(list(better.values()), list(runs.values())).lower < 0.0


def test_against_a_number_is_student(groups):
    found, reference = compare_with(list(groups[1]), 0.5), stats.ttest_1samp(groups[1], 0.5)
    assert found.p() == pytest.approx(reference.pvalue)


def test_p_of_another_threshold(groups):
    reference = stats.ttest_ind(groups[0] - 2.0, groups[1], equal_var=False)
    assert compare_unpaired(*groups).p(2.0) == pytest.approx(reference.pvalue)


def test_improvement_is_the_share_of_pairs():
    assert compare_unpaired([1.0, 3.0], [0.0, 3.0]).improvement == pytest.approx((1 + 0 + 1 + 0.5) / 4)


def test_no_spread_has_the_p_value_of_the_permutation_test():
    found = compare_unpaired([1.0] * 3, [0.0] * 3)
    assert (found.lower, found.upper) == (1.0, 1.0)
    assert found.p() == pytest.approx(2 / 20)  # 2 of the 20 ways to choose 3 of 6 are as extreme


def test_permutation_of_two_groups_counts_by_hand():
    """Of the 10 ways to choose 2 of 5, only {8, 9} is as great as the left side: one-sided 1 / 10."""
    found = compare_unpaired([8.0, 9.0], [1.0, 2.0, 3.0])
    assert found.permutation_p() == pytest.approx(2 / 10)
    assert found.permutation_p(6.5) == pytest.approx(1.0)  # shifted by their difference the sides are alike


@pytest.mark.parametrize(("n", "m"), [(2, 3), (3, 3), (5, 5)])
def test_no_permutation_p_is_below_the_least_one(n, m):
    """Sides that do not overlap are as far apart as any."""
    found = compare_unpaired([float(k) for k in range(n)], [100.0 + k for k in range(m)])
    assert found.permutation_p() == pytest.approx(found.least_permutation_p)
    alone = compare_with([1.0 + k for k in range(n)], 0.0)
    assert alone.permutation_p() == pytest.approx(alone.least_permutation_p)


def test_permutation_of_pairs_flips_signs():
    """All four differences are positive: 1 of 2^4 flips is as great, or 2 where the least difference is 0."""
    left, right = {0: 2.0, 1: 3.0, 2: 4.0, 3: 5.0}, dict.fromkeys(range(4), 1.0)
    assert compare_paired(left, right).permutation_p() == pytest.approx(2 / 16)
    assert compare_with([2.0, 3.0, 4.0, 5.0], 2.0).permutation_p() == pytest.approx(4 / 16)


def test_a_large_permutation_test_is_near_welch_and_gives_the_same_p_twice():
    rng = np.random.default_rng(5)
    left, right = rng.normal(0.6, 1.0, 20), rng.normal(0.0, 1.0, 20)
    found = compare_unpaired(left, right)
    assert found.permutation_p() == pytest.approx(found.p(), abs=0.01)
    assert found.permutation_p() == compare_unpaired(left, right).permutation_p()


@pytest.mark.parametrize("runs", [3, 6, 20])
@pytest.mark.parametrize("value", [0.0, 1.0])
def test_runs_that_agree_have_no_spread_whatever_their_rounding(value, runs):
    """0.9 three times has a standard deviation of 1e-16; a t test would find p = 1e-32."""
    found = compare_with([value] * runs, 0.1)
    assert found.half == 0.0
    assert found.p() == found.permutation_p() > 1e-6


def test_ties_with_a_number_count_half():
    assert compare_with([1.0, 2.0, 3.0, 3.0], 2.0).improvement == pytest.approx((0 + 0.5 + 1 + 1) / 4)


def test_one_run_gives_no_interval():
    found = compare_unpaired([1.0], [0.0, 2.0])
    assert math.isnan(found.lower)
    assert math.isnan(found.p())
    assert math.isnan(found.permutation_p())


def test_holm():
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])


def test_holm_counts_comparisons_that_are_not_there_yet():
    now, later = [0.01, math.nan, 0.03, 0.005], [0.01, 0.04, 0.03, 0.005]
    adjusted = holm(now)
    assert adjusted == pytest.approx([0.03, math.nan, 0.06, 0.02], nan_ok=True)
    assert all(a <= b or math.isnan(b) for a, b in zip(holm(later), adjusted, strict=True))


def test_a_mean_of_differences_by_hand():
    """Errors 3 and 4: the mean has sqrt(9 + 16) / 2 = 2.5, and 625 / (81 / 4 + 256 / 9) degrees of freedom."""
    first = Difference(5.0, 1.0, 3.0, 4.0, 0.9, 5, 7, "Welch t")
    second = Difference(2.0, 0.0, 4.0, 9.0, 0.5, 10, 6, "Welch t")
    found = mean_difference([first, second])
    assert (found.estimate, found.error) == pytest.approx((3.0, 2.5))
    assert found.freedom == pytest.approx(625.0 / (81.0 / 4.0 + 256.0 / 9.0))
    assert found.improvement == pytest.approx(0.7)
    assert (found.n_left, found.n_right) == (5, 6)
    scaled = mean_difference([first, second], [2.0, 4.0])
    assert scaled.estimate == pytest.approx((4.0 / 2.0 + 2.0 / 4.0) / 2.0)
    assert scaled.error == pytest.approx(math.hypot(3.0 / 2.0, 4.0 / 4.0) / 2.0)


def test_adjusted_p_values_are_at_most_1():
    assert holm([0.9, 0.8]) == [1.0, 1.0]


def test_a_tie_of_paired_runs_counts_half():
    found = compare_paired({0: 1.0, 1: 2.0, 2: 4.0, 3: 0.0}, {0: 1.0, 1: 1.0, 2: 3.0, 3: 5.0})
    assert found.improvement == pytest.approx((0.5 + 1 + 1 + 0) / 4)
