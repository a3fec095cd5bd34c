"""Intervals, survival curves and differences against what is known beforehand, and against SciPy."""

import math
import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy import stats

from perdure.stats import (
    Difference,
    FailureRate,
    Units,
    bootstrap_interval,
    clopper_pearson,
    compare_paired,
    compare_unpaired,
    compare_with,
    estimate_interval,
    fewer_p,
    kaplan_meier,
    make_units,
    mean_difference,
    mean_interval,
    measure_failure_rate,
    median_time,
    survival_interval,
    t_interval,
)


def rng(seed=0):
    return np.random.default_rng(seed)


def covered(interval, truth):
    return float(((interval.lower <= truth) & (truth <= interval.upper)).mean())


# Many samples are the columns of one curve: every column has an interval of its own.


@pytest.mark.parametrize(
    ("draw", "truth"),
    [
        (lambda r: r.normal(5.0, 2.0, (24, 400)), 5.0),
        (lambda r: r.exponential(3.0, (40, 400)), 3.0),
        (lambda r: r.random((30, 400)), 0.5),
    ],
)
def test_a_95_percent_interval_covers_the_true_mean_about_as_often(draw, truth):
    assert 0.88 <= covered(bootstrap_interval(Units(draw(rng(1)), "x"), rng(), resamples=400), truth) <= 0.99


def test_a_50_percent_interval_covers_about_half_the_time_and_a_wrong_mean_is_missed():
    units = Units(rng(1).normal(5.0, 2.0, (24, 400)), "x")
    assert 0.40 <= covered(bootstrap_interval(units, rng(), confidence=0.5, resamples=400), 5.0) <= 0.60
    assert covered(bootstrap_interval(units, rng(), resamples=400), 6.5) < 0.12


def test_with_three_units_student_covers_95_percent_and_a_bootstrap_far_less():
    units = Units(rng(4).normal(5.0, 2.0, (3, 3000)), "x")
    assert 0.935 < covered(estimate_interval(units, rng()), 5.0) < 0.965
    assert covered(bootstrap_interval(units, rng(), resamples=200), 5.0) < 0.82


def test_students_interval_as_in_the_tables():
    """t(2) = 4.3027 at 97.5 % and 2.9200 at 95 %: 2 -+ t / sqrt(3)."""
    three = Units(np.array([1.0, 3.0, 2.0]), "x")
    interval, narrow = estimate_interval(three, rng()), t_interval(three, confidence=0.9)
    assert (interval.lower, interval.upper) == pytest.approx((2.0 - 2.484140, 2.0 + 2.484140), abs=1e-5)
    assert (narrow.lower, narrow.upper) == pytest.approx((2.0 - 1.685854, 2.0 + 1.685854), abs=1e-5)
    assert interval.method == "Student t"
    assert estimate_interval(Units(np.arange(9.0), "x"), rng()).method == "Student t"
    assert estimate_interval(Units(np.arange(10.0), "x"), rng()).method == "bootstrap"


def test_resampling_episodes_instead_of_runs_misses_the_mean_which_is_why_runs_are_the_units():
    # 6 runs whose true levels differ (sd 1), 50 episodes each with little noise: the mean is known to +- 1/sqrt(6).
    source, runs = rng(3), np.repeat(np.arange(6), 50)
    episodes = np.repeat(source.normal(size=(6, 200)), 50, axis=0) + source.normal(scale=0.1, size=(300, 200))
    assert covered(mean_interval(episodes, runs, source), 0.0) > 0.88
    blind = bootstrap_interval(make_units(episodes, np.zeros(300)), source, resamples=300)
    assert covered(blind, 0.0) < 0.35


def test_episodes_are_averaged_within_their_run_whatever_their_number():
    units = make_units([1.0, 3.0, 10.0, 10.0, 10.0, 10.0, 6.0], [*"aabbbbc"])
    assert units.values.tolist() == [2.0, 10.0, 6.0]
    assert (units.label, units.count) == ("training seeds", 3)
    interval = bootstrap_interval(units, rng())
    assert interval.estimate == 6.0
    assert (interval.lower, interval.upper) == (2.0, 10.0)


def test_one_run_resamples_its_episodes_and_says_so():
    interval = mean_interval(np.arange(9.0), np.full(9, 7), rng())
    assert (interval.label, interval.count) == ("evaluation seeds only", 9)
    assert interval.estimate == 4.0
    assert 1.5 < interval.lower < 4.0 < interval.upper < 6.5


def test_a_two_point_bootstrap_is_the_binomial_distribution():
    # 40 zeros and 60 ones: the resampled mean is Binomial(100, 0.6) / 100, whose 2.5 % and 97.5 % points are 50 and 69.
    scores = np.repeat([0.0, 1.0], [40, 60])
    interval = bootstrap_interval(Units(scores, "x"), rng(), resamples=20_000)
    assert float(interval.lower) == pytest.approx(0.50, abs=0.011)
    assert float(interval.upper) == pytest.approx(0.69, abs=0.011)


@pytest.mark.parametrize("interval", [bootstrap_interval, estimate_interval])
def test_degenerate_data_give_an_answer_without_warnings(interval):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        one = interval(Units(np.array([3.0]), "x"), rng())
        two = interval(Units(np.arange(10.0).reshape(2, 5), "x"), rng())
        same = interval(Units(np.full(5, 3.0), "x"), rng())
        nearly = interval(Units(np.array([0.0, 1, 1, 1, 1, 1, 1, 1, 9]), "x"), rng())
        broken = interval(Units(np.array([1.0, math.nan, 2.0]), "x"), rng())
        endless = interval(Units(np.array([1.0, math.inf, 2.0]), "x"), rng())
    assert one.estimate == same.estimate == same.lower == same.upper == 3.0
    assert np.isnan([*two.lower, *two.upper, one.lower]).all()
    assert np.isnan(one.upper)
    assert nearly.lower <= nearly.estimate <= nearly.upper
    assert np.isnan([broken.estimate, broken.lower, endless.estimate, endless.upper]).all()


@pytest.mark.parametrize("interval", [bootstrap_interval, estimate_interval])
def test_a_broken_point_of_a_curve_does_not_break_the_others(interval):
    curves = np.array([[1.0, math.nan, 5.0], [1.0, 2.0, 7.0], [1.0, 3.0, 9.0]])
    found = interval(Units(curves, "x"), rng())
    assert found.estimate[[0, 2]].tolist() == [1.0, 7.0]
    assert np.isnan(found.estimate[1])
    assert found.lower[0] == found.upper[0] == 1.0
    assert found.lower[2] < 7.0 < found.upper[2]


def test_the_same_generator_gives_the_same_interval_and_another_a_different_one():
    units = Units(rng(5).normal(size=(12, 3)), "x")
    first, again, other = (bootstrap_interval(units, rng(seed)) for seed in (1, 1, 2))
    assert first.lower.tolist() == again.lower.tolist()
    assert first.lower.tolist() != other.lower.tolist()


def test_the_bootstrap_draws_units_for_all_points_of_a_curve_at_once():
    """The reference: draw rows, average, take percentiles."""
    values = rng(5).normal(size=(12, 3))
    drawn = values.T[..., rng(1).integers(0, 12, (2000, 12))].mean(axis=-1)
    found = bootstrap_interval(Units(values, "x"), rng(1))
    np.testing.assert_allclose([found.lower, found.upper], np.quantile(drawn, (0.025, 0.975), axis=-1), rtol=1e-12)


def test_survival_under_a_known_hazard_is_the_exponential():
    hazard, steps = 1e-3, np.array([100, 500, 1000, 2000])
    ends = rng(2).geometric(hazard, size=4000)
    alive = ends[:, None] > steps
    curve = survival_interval(alive, np.zeros(4000), rng())
    truth = np.exp(-hazard * steps)
    assert np.all((curve.lower - 0.005 < truth) & (truth < curve.upper + 0.005))
    assert np.all(curve.upper - curve.lower < 0.035)
    assert not np.any((curve.lower < np.exp(-2 * hazard * steps)) & (np.exp(-2 * hazard * steps) < curve.upper))


def test_clopper_pearson_reproduces_the_published_example():
    # Newcombe (1998), Statistics in Medicine 17, table I, method 5.
    published = {
        (81, 263): (0.2527, 0.3676),
        (15, 148): (0.0578, 0.1617),
        (0, 20): (0.0, 0.1684),
        (1, 29): (0.0009, 0.1776),
    }
    for (hits, count), bounds in published.items():
        lower, upper = clopper_pearson(hits / count, count)
        assert (float(lower), float(upper)) == pytest.approx(bounds, abs=5e-5)


@pytest.mark.parametrize(("confidence", "count"), [(0.9, 7), (0.95, 36)])
def test_clopper_pearson_is_scipys_for_many_shares_at_once(confidence, count):
    lower, upper = clopper_pearson(np.arange(count + 1) / count, count, confidence)
    found = [stats.binomtest(k, count).proportion_ci(confidence, "exact") for k in range(count + 1)]
    np.testing.assert_allclose(lower, [each.low for each in found], atol=1e-9)
    np.testing.assert_allclose(upper, [each.high for each in found], atol=1e-9)
    tail = ((1.0 - confidence) / 2.0) ** (1.0 / count)
    assert (lower[0], upper[0], lower[-1], upper[-1]) == pytest.approx((0.0, 1.0 - tail, tail, 1.0))


class TestFailureRate:
    def test_five_failures_in_twenty_hours(self):
        """By hand: chi-square of 12 degrees of freedom has the 95 % quantile 21.026."""
        rate = FailureRate(5, 20.0, 2)
        assert (rate.per_hour, rate.mean_hours) == (0.25, 4.0)
        assert rate.upper == pytest.approx(21.026 / 2 / 20, abs=1e-5)
        assert rate.upper == pytest.approx(stats.chi2.ppf(0.95, 12) / 40)
        assert rate.lower == pytest.approx(stats.chi2.ppf(0.05, 10) / 40)

    def test_no_failure_has_a_bound(self):
        rate = FailureRate(0, 20.0, 0)
        assert (rate.per_hour, rate.lower, rate.mean_hours) == (0.0, 0.0, math.inf)
        assert rate.upper == pytest.approx(-math.log(0.05) / 20.0), "the rule of three"
        assert rate.constant_p == 1.0

    def test_the_bounds_are_exact(self):
        """At the upper bound so few failures have the probability 5 %, at the lower one so many."""
        rate = FailureRate(3, 2.0, 0)
        assert stats.poisson.cdf(3, 2.0 * rate.upper) == pytest.approx(0.05)
        assert stats.poisson.sf(2, 2.0 * rate.lower) == pytest.approx(0.05)

    def test_failures_and_exposure_by_hand(self):
        """Until step 10 three episodes give 30 steps, until 20 another 20, until 40 another 20: half of 70 is 35."""
        rate = measure_failure_rate([40, 10, 20], [False, True, True], 0.5)
        assert (rate.events, rate.exposure_hours, rate.early) == (2, 35.0, 1)

    @pytest.mark.parametrize("early", [0, 1, 4, 8])
    def test_the_test_of_a_constant_hazard_is_binomial(self, early):
        assert FailureRate(8, 1.0, early).constant_p == pytest.approx(stats.binomtest(early, 8).pvalue)

    @pytest.mark.parametrize(("shape", "least", "most"), [(1.0, 0.0, 0.06), (0.4, 0.8, 1.0), (3.0, 0.8, 1.0)])
    def test_a_hazard_that_changes_is_noticed_and_a_constant_one_is_not(self, shape, least, most):
        """Weibull: infant mortality, constant and wear; 40 episodes, watched for 1.5 times the scale."""
        ends = rng(5).weibull(shape, (400, 40))
        found = [measure_failure_rate(np.minimum(each, 1.5), each < 1.5, 1.0).constant_p >= 0.05 for each in ends]
        assert least <= 1.0 - np.mean(found) <= most


def test_survival_of_several_runs_resamples_runs():
    alive = np.array([[1, 1], [1, 1], [0, 1], [0, 1], [1, 1], [0, 1]], dtype=bool)
    curve = survival_interval(alive, [0, 0, 1, 1, 2, 2], rng())
    assert (curve.estimate[0], curve.lower[0], curve.upper[0]) == (0.5, 0.0, 1.0)
    assert np.isnan([curve.lower[1], curve.upper[1]]).all(), "runs that agree are no certainty"
    assert (curve.label, curve.count) == ("training seeds", 3)


def test_kaplan_meier_by_hand():
    """1 of 5 fails at 2; one is cut at 3, as another fails: it still counts; 1 of the 2 left fails at 7."""
    times, failed = [2.0, 3.0, 3.0, 7.0, 9.0], [True, True, False, True, False]
    at, share = kaplan_meier(times, failed)
    assert dict(zip(at.tolist(), share.tolist(), strict=True)) == pytest.approx({2: 0.8, 3: 0.6, 7: 0.3, 9: 0.3})
    assert median_time(times, failed) == 7.0
    assert math.isnan(median_time([1.0, 2.0], [False, False]))
    assert median_time([0.0, 5.0], [True, False]) == 0.0


@pytest.mark.parametrize(("values", "runs"), [([], []), ([1.0, 2.0], [0]), (1.0, 0), ([[1.0]], [[0]])])
def test_shapes_that_do_not_fit_are_refused(values, runs):
    with pytest.raises(ValueError, match="one run per episode"):
        make_units(values, runs)


@settings(max_examples=40, deadline=None)
@given(
    arrays(np.float64, st.tuples(st.integers(3, 8), st.integers(1, 3)), elements=st.floats(-1e6, 1e6)),
)
def test_percentile_bounds_lie_within_the_data_and_move_with_it(scores):
    interval = bootstrap_interval(Units(scores, "x"), rng(), resamples=100)
    slack = 1e-9 * (1.0 + np.abs(scores).max())
    assert np.all(scores.min(axis=0) - slack <= interval.lower)
    assert np.all(interval.lower <= interval.upper)
    assert np.all(interval.upper <= scores.max(axis=0) + slack)
    moved = bootstrap_interval(Units(-scores, "x"), rng(), resamples=100)
    assert moved.estimate == pytest.approx(-interval.estimate, abs=float(slack))


# Differences


@pytest.fixture
def groups():
    rng = np.random.default_rng(3)
    return rng.normal(1.0, 1.0, 5), rng.normal(0.0, 3.0, 9)


def test_unpaired_is_welch(groups):
    found, reference = compare_unpaired(*groups), stats.ttest_ind(*groups, equal_var=False)
    interval = reference.confidence_interval(0.95)
    assert (found.lower, found.upper) == pytest.approx((interval.low, interval.high))
    assert found.count == 5


def test_paired_is_student_over_differences_of_common_runs(groups):
    left, right = dict(enumerate(groups[0])), dict(enumerate(groups[1]))
    found, reference = compare_paired(left, right), stats.ttest_rel(groups[0], groups[1][:5])
    interval = reference.confidence_interval(0.95)
    assert (found.lower, found.upper) == pytest.approx((interval.low, interval.high))


def test_pairing_narrows_the_interval_of_runs_that_vary_together():
    runs = {seed: 10.0 * seed for seed in range(5)}
    better = {seed: value + 1.0 + 0.01 * seed for seed, value in runs.items()}
    assert compare_paired(better, runs).lower > 0.0
    assert compare_unpaired(list(better.values()), list(runs.values())).lower < 0.0


def test_against_a_number_is_student(groups):
    found, reference = compare_with(list(groups[1]), 0.5), stats.ttest_1samp(groups[1], 0.5)
    interval = reference.confidence_interval(0.95)
    assert (found.lower + 0.5, found.upper + 0.5) == pytest.approx((interval.low, interval.high))


@pytest.mark.parametrize("runs", [3, 6, 20])
@pytest.mark.parametrize("value", [0.0, 1.0])
def test_runs_that_agree_have_no_spread_whatever_their_rounding(value, runs):
    """0.9 three times has a standard deviation of 1e-16, which is rounding."""
    found = compare_with([value] * runs, 0.1)
    assert found.half == 0.0


def test_one_run_gives_no_interval():
    found = compare_unpaired([1.0], [0.0, 2.0])
    assert math.isnan(found.lower)


def test_a_mean_of_differences_by_hand():
    """Errors 3 and 4: the mean has sqrt(9 + 16) / 2 = 2.5, and 625 / (81 / 4 + 256 / 9) degrees of freedom."""
    first = Difference(5.0, 1.0, 3.0, 4.0, 5)
    second = Difference(2.0, 0.0, 4.0, 9.0, 6)
    found = mean_difference([first, second])
    assert (found.estimate, found.error) == pytest.approx((3.0, 2.5))
    assert found.freedom == pytest.approx(625.0 / (81.0 / 4.0 + 256.0 / 9.0))
    assert found.count == 5


@pytest.mark.parametrize("table", [(1, 5, 5, 5), (2, 5, 5, 5), (0, 3, 3, 3), (7, 40, 20, 41), (3, 3, 0, 4)])
def test_fewer_hits_than_another_group(table):
    hits, count, other_hits, other_count = table
    rows = [[hits, count - hits], [other_hits, other_count - other_hits]]
    assert fewer_p(*table) == pytest.approx(stats.fisher_exact(rows, alternative="less").pvalue)
    assert fewer_p(0, count, 0, other_count) == 1.0
