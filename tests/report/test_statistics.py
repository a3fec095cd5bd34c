"""Intervals against what is known beforehand."""

import math
import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from perdure.report import (
    Bootstrap,
    ReportError,
    Units,
    bootstrap_interval,
    difference_interval,
    estimate_interval,
    make_units,
    mean_interval,
    survival_interval,
)
from perdure.report.statistics import wilson


def rng(seed=0):
    return np.random.default_rng(seed)


def coverage(draw, truth, how, repetitions=300):
    """Share of repetitions whose interval holds the true mean."""
    source = rng(1)
    hits = 0
    for _ in range(repetitions):
        interval = bootstrap_interval(Units(draw(source), "x"), source, how)
        hits += bool(interval.lower <= truth <= interval.upper)
    return hits / repetitions


@pytest.mark.parametrize("method", ["percentile", "BCa"])
@pytest.mark.parametrize(
    ("draw", "truth"),
    [(lambda r: r.normal(5.0, 2.0, 24), 5.0), (lambda r: r.exponential(3.0, 40), 3.0), (lambda r: r.random(30), 0.5)],
)
def test_a_95_percent_interval_covers_the_true_mean_about_as_often(draw, truth, method):
    assert 0.88 <= coverage(draw, truth, Bootstrap(method=method, resamples=400)) <= 0.99


def test_a_50_percent_interval_covers_about_half_the_time_and_a_wrong_mean_is_missed():
    def draw(source):
        return source.normal(5.0, 2.0, 24)

    assert 0.40 <= coverage(draw, 5.0, Bootstrap(confidence=0.5, resamples=400)) <= 0.60
    assert coverage(draw, 6.5, Bootstrap(resamples=400)) < 0.12


def test_students_interval_as_in_the_tables():
    """t(2) = 4.3027 at 97.5 %: 2 -+ 4.3027 / sqrt(3)."""
    interval = estimate_interval(Units(np.array([1.0, 3.0, 2.0]), "x"), rng())
    assert (interval.lower, interval.upper) == pytest.approx((2.0 - 2.484140, 2.0 + 2.484140), abs=1e-5)
    assert interval.method == "Student t"
    assert estimate_interval(Units(np.arange(9.0), "x"), rng()).method == "Student t"
    assert estimate_interval(Units(np.arange(10.0), "x"), rng()).method == "bootstrap"


def test_another_confidence_is_used_by_every_interval():
    """t(2) = 2.9200 and z = 1.6449 at 95 %."""
    how, three = Bootstrap(confidence=0.9), Units(np.array([1.0, 3.0, 2.0]), "training seeds")
    interval = estimate_interval(three, rng(), how)
    assert (interval.lower, interval.upper) == pytest.approx((2.0 - 1.685854, 2.0 + 1.685854), abs=1e-5)
    difference = difference_interval(three, Units(np.full(3, 2.0), "training seeds"), rng(), how)
    assert (difference.lower, difference.upper) == pytest.approx((-1.685854, 1.685854), abs=1e-5)
    assert [float(each) for each in wilson(0.0, 20, 0.9)] == pytest.approx([0.0, 2.705543 / (20.0 + 2.705543)])
    alive = survival_interval(np.zeros(20, dtype=bool), np.zeros(20), rng(), how)
    assert float(alive.upper) == pytest.approx(2.705543 / (20.0 + 2.705543))
    many = Units(rng(3).normal(0.0, 1.0, 40), "x")
    for method in ("percentile", "BCa"):
        wide, narrow = (
            estimate_interval(many, rng(), Bootstrap(method=method, confidence=each)) for each in (0.95, 0.5)
        )
        assert float(narrow.upper - narrow.lower) < 0.6 * float(wide.upper - wide.lower)


def test_one_group_that_agrees_beside_one_that_varies_has_an_interval():
    varied = Units(rng(2).normal(0.0, 1.0, 12), "x")
    found = difference_interval(Units(np.full(12, 1.0), "x"), varied, rng())
    assert float(found.upper - found.lower) > 0.5


def test_with_three_units_student_covers_95_percent_and_a_bootstrap_far_less():
    source, student, bootstrap = rng(4), 0, 0
    for _ in range(1500):
        units = Units(source.normal(5.0, 2.0, 3), "x")
        interval = estimate_interval(units, source)
        student += bool(interval.lower <= 5.0 <= interval.upper)
    for _ in range(300):
        interval = bootstrap_interval(Units(source.normal(5.0, 2.0, 3), "x"), source, Bootstrap(resamples=200))
        bootstrap += bool(interval.lower <= 5.0 <= interval.upper)
    assert 0.935 < student / 1500 < 0.965
    assert bootstrap / 300 < 0.82


@pytest.mark.parametrize(("statistic", "trim"), [("mean", 0.0), ("iqm", 0.25)])
def test_few_units_differ_as_scipys_welch_and_yuen_tests_say(statistic, trim):
    """At a bound of the 95 % interval the p-value of the test is 0.05."""
    from scipy.stats import ttest_ind

    left, right = np.array([3.1, 4.7, 2.2, 6.0, 3.3, 9.9, 4.1]), np.array([1.0, 0.2, 2.5, 1.7, 0.9])
    found = difference_interval(Units(left, "x"), Units(right, "x"), rng(), Bootstrap(statistic))
    for bound in (float(found.lower), float(found.upper)):
        assert ttest_ind(left - bound, right, equal_var=False, trim=trim).pvalue == pytest.approx(0.05, abs=1e-6)


def test_resampling_lanes_instead_of_runs_misses_the_mean_which_is_why_runs_are_the_units():
    # 6 runs whose true levels differ (sd 1), 50 lanes each with little noise: the mean is known to +- 1/sqrt(6).
    source, by_run, by_lane = rng(3), 0, 0
    runs = np.repeat(np.arange(6), 50)
    for _ in range(200):
        lanes = np.repeat(source.normal(size=6), 50) + source.normal(scale=0.1, size=300)
        honest = mean_interval(lanes, runs, source, Bootstrap(resamples=300))
        blind = mean_interval(lanes, np.zeros(300), source, Bootstrap(resamples=300))
        by_run += bool(honest.lower <= 0.0 <= honest.upper)
        by_lane += bool(blind.lower <= 0.0 <= blind.upper)
    assert by_run / 200 > 0.78
    assert by_lane / 200 < 0.35


def test_lanes_are_averaged_within_their_run_whatever_their_number():
    units = make_units([1.0, 3.0, 10.0, 10.0, 10.0, 10.0], ["a", "a", "b", "b", "b", "b"])
    assert units.values.tolist() == [2.0, 10.0]
    assert (units.label, units.count) == ("training seeds", 2)
    interval = bootstrap_interval(units, rng())
    assert interval.estimate == 6.0
    assert (interval.lower, interval.upper) == (2.0, 10.0)


def test_one_run_resamples_its_lanes_and_says_so():
    interval = mean_interval(np.arange(9.0), np.full(9, 7), rng())
    assert (interval.label, interval.count) == ("evaluation seeds only", 9)
    assert interval.estimate == 4.0
    assert 1.5 < interval.lower < 4.0 < interval.upper < 6.5


def test_the_iqm_ignores_the_outer_quarters():
    scores = np.array([-1e6, 0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 1e9])
    assert bootstrap_interval(Units(scores, "x"), rng(), Bootstrap("iqm")).estimate == 2.5
    assert bootstrap_interval(Units(scores, "x"), rng(), Bootstrap("mean")).estimate == scores.mean()


def test_a_two_point_bootstrap_is_the_binomial_distribution():
    # 40 zeros and 60 ones: the resampled mean is Binomial(100, 0.6) / 100, whose 2.5 % and 97.5 % points are 50 and 69.
    scores = np.repeat([0.0, 1.0], [40, 60])
    interval = bootstrap_interval(Units(scores, "x"), rng(), Bootstrap(resamples=20_000))
    assert float(interval.lower) == pytest.approx(0.50, abs=0.011)
    assert float(interval.upper) == pytest.approx(0.69, abs=0.011)


@pytest.mark.parametrize("how", [Bootstrap(s, m) for s in ("mean", "iqm") for m in ("percentile", "BCa")])
def test_degenerate_data_give_an_answer_without_warnings(how):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        one = bootstrap_interval(Units(np.array([3.0]), "x"), rng(), how)
        same = bootstrap_interval(Units(np.full(5, 3.0), "x"), rng(), how)
        nearly = bootstrap_interval(Units(np.array([0.0, 1, 1, 1, 1, 1, 1, 1, 9]), "x"), rng(), how)
        broken = bootstrap_interval(Units(np.array([1.0, math.nan, 2.0]), "x"), rng(), how)
        endless = bootstrap_interval(Units(np.array([1.0, math.inf, 2.0]), "x"), rng(), how)
    assert one.estimate == same.estimate == same.lower == same.upper == 3.0
    assert np.isnan(one.lower)
    assert np.isnan(one.upper)
    assert nearly.lower <= nearly.estimate <= nearly.upper
    assert np.isnan([broken.estimate, broken.lower, endless.estimate, endless.upper]).all()


def test_a_broken_point_of_a_curve_does_not_break_the_others():
    curves = np.array([[1.0, math.nan, 5.0], [1.0, 2.0, 7.0], [1.0, 3.0, 9.0]])
    interval = bootstrap_interval(Units(curves, "x"), rng())
    assert interval.estimate[[0, 2]].tolist() == [1.0, 7.0]
    assert np.isnan(interval.estimate[1])
    assert interval.lower[0] == interval.upper[0] == 1.0
    assert 5.0 <= interval.lower[2] < 7.0 < interval.upper[2] <= 9.0


def test_the_same_generator_gives_the_same_interval_and_another_a_different_one():
    units = Units(rng(5).normal(size=(12, 3)), "x")
    first, again, other = (bootstrap_interval(units, rng(seed)) for seed in (1, 1, 2))
    assert first.lower.tolist() == again.lower.tolist()
    assert first.lower.tolist() != other.lower.tolist()


def test_the_global_generator_is_left_alone():
    np.random.seed(0)  # noqa: NPY002
    before = np.random.get_state()[1].tolist()  # noqa: NPY002
    bootstrap_interval(Units(rng().normal(size=9), "x"), rng(), Bootstrap(method="BCa"))
    assert np.random.get_state()[1].tolist() == before  # noqa: NPY002


def test_survival_under_a_known_hazard_is_the_exponential():
    hazard, steps = 1e-3, np.array([100, 500, 1000, 2000])
    ends = rng(2).geometric(hazard, size=4000)
    alive = ends[:, None] > steps
    curve = survival_interval(alive, np.zeros(4000), rng())
    truth = np.exp(-hazard * steps)
    assert np.all((curve.lower - 0.005 < truth) & (truth < curve.upper + 0.005))
    assert np.all(curve.upper - curve.lower < 0.035)
    assert not np.any((curve.lower < np.exp(-2 * hazard * steps)) & (np.exp(-2 * hazard * steps) < curve.upper))


def test_wilson_reproduces_the_published_example_and_keeps_a_width_at_the_ends():
    # Newcombe (1998), Statistics in Medicine 17, table I, method 3: 81 of 263, 15 of 148, 0 of 20, 1 of 29.
    published = {
        (81, 263): (0.2553, 0.3662),
        (15, 148): (0.0624, 0.1605),
        (0, 20): (0.0, 0.1611),
        (1, 29): (0.0061, 0.1718),
    }
    for (hits, count), bounds in published.items():
        lower, upper = wilson(hits / count, count)
        assert (float(lower), float(upper)) == pytest.approx(bounds, abs=5e-5)
    lower, upper = wilson(1.0, 24)
    assert 0.8 < lower < upper == 1.0


def test_survival_of_several_runs_resamples_runs():
    alive = np.array([1, 1, 1, 1, 0, 0, 0, 0], dtype=bool)
    curve = survival_interval(alive, [0, 0, 0, 0, 1, 1, 1, 1], rng())
    assert (curve.estimate, curve.lower, curve.upper) == (0.5, 0.0, 1.0)
    assert (curve.label, curve.count) == ("training seeds", 2)


def test_the_difference_covers_a_known_difference_and_excludes_none():
    source, hits, zeros = rng(7), 0, 0
    for _ in range(200):
        left, right = Units(source.normal(3.0, 1.0, 20), "x"), Units(source.normal(1.0, 2.0, 30), "x")
        interval = difference_interval(left, right, source, Bootstrap(resamples=400))
        hits += bool(interval.lower <= 2.0 <= interval.upper)
        zeros += bool(interval.lower <= 0.0 <= interval.upper)
    assert 0.88 <= hits / 200 <= 0.99
    assert zeros / 200 < 0.1


def test_a_difference_is_signed_labeled_and_degenerates_quietly():
    left, right = Units(np.full(4, 5.0), "training seeds"), Units(np.full(3, 2.0), "evaluation seeds only")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        same = difference_interval(left, right, rng())
        single = difference_interval(left, Units(np.array([1.0]), "training seeds"), rng())
        half = difference_interval(
            left, Units(np.array([1.0, 3.0, 2.0]), "training seeds"), rng(), Bootstrap(method="BCa")
        )
    assert (same.estimate, same.lower, same.upper) == (3.0, 3.0, 3.0)
    assert same.label == "training seeds against evaluation seeds only"
    assert single.estimate == 4.0
    assert np.isnan(single.lower)
    assert (half.lower, half.upper) == pytest.approx((3.0 - 4.302653 / 3**0.5, 3.0 + 4.302653 / 3**0.5))
    with pytest.raises(ReportError, match="one number per unit"):
        difference_interval(Units(np.zeros((3, 2)), "x"), right, rng())


@pytest.mark.parametrize(
    "wrong", [{"statistic": "mode"}, {"method": "basic"}, {"confidence": 95}, {"confidence": 0.0}, {"resamples": 0}]
)
def test_wrong_settings_are_refused_by_value(wrong):
    with pytest.raises(ReportError, match=str(next(iter(wrong.values())))):
        Bootstrap(**wrong)


@pytest.mark.parametrize(("values", "runs"), [([], []), ([1.0, 2.0], [0]), (1.0, 0), ([[1.0]], [[0]])])
def test_shapes_that_do_not_fit_are_refused(values, runs):
    with pytest.raises(ReportError, match="one run per lane"):
        make_units(values, runs)


@settings(max_examples=40, deadline=None)
@given(
    arrays(np.float64, st.tuples(st.integers(2, 8), st.integers(1, 3)), elements=st.floats(-1e6, 1e6)),
    st.sampled_from(["mean", "iqm"]),
)
def test_percentile_bounds_lie_within_the_data_and_move_with_it(scores, statistic):
    how = Bootstrap(statistic, resamples=100)
    interval = bootstrap_interval(Units(scores, "x"), rng(), how)
    slack = 1e-9 * (1.0 + np.abs(scores).max())
    assert np.all(scores.min(axis=0) - slack <= interval.lower)
    assert np.all(interval.lower <= interval.upper)
    assert np.all(interval.upper <= scores.max(axis=0) + slack)
    moved = bootstrap_interval(Units(-scores, "x"), rng(), how)
    assert moved.estimate == pytest.approx(-interval.estimate, abs=float(slack))
