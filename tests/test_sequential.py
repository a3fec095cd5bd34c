"""The sequential interval against numbers worked out by hand, and against its promised error rate."""

import math

import numpy as np
import pytest

from perdure.sequential import BETS, betting_interval, log_wealth, pairs_until_decided

PAIRS = 200
LOOKS = (8, 12, 18, 27, 41, 62, 93, 140, 200)


def wealth(differences, span):
    """Wealth of bettors on a positive mean, after every pair: the definition, one bet and pair at a time."""
    steps = []
    purses = np.ones(len(BETS))
    for value in differences:
        purses *= 1.0 + BETS * value / span
        steps.append(purses.mean())
    return np.array(steps)


def test_wealth_is_the_mean_product_of_all_bets():
    differences = np.array([0.5, -0.25, 1.0])
    by_hand = np.mean([(1 + b / 2) * (1 - b / 4) * (1 + b) for b in BETS])
    assert log_wealth(differences, 1.0) == pytest.approx(math.log(by_hand))
    assert log_wealth([], 1.0) == 0.0


def test_the_order_of_the_pairs_does_not_matter():
    differences = np.random.default_rng(0).uniform(-1, 1, 30)
    assert betting_interval(differences, 1.5) == pytest.approx(betting_interval(differences[::-1], 1.5))


def test_seven_wins_do_not_decide_and_eight_do():
    # All on one side: the mean over bets b of (1 + b) ** n is 38 after 7 wins, and 40 are needed.
    assert betting_interval(np.ones(7), 1.0)[0] < 0.0 < betting_interval(np.ones(8), 1.0)[0]
    assert pairs_until_decided(np.ones(3), 1.0) == 8


def test_the_interval_turns_with_its_sides_and_scales_with_its_unit():
    differences = np.random.default_rng(1).normal(0.2, 0.3, 50).clip(-1, 1)
    low, high = betting_interval(differences, 1.0)
    assert -1.0 < low < differences.mean() < high < 1.0
    assert betting_interval(-differences, 1.0) == pytest.approx((-high, -low))
    assert betting_interval(10 * differences, 10.0) == pytest.approx((10 * low, 10 * high))


def test_without_a_pair_nothing_is_known():
    assert betting_interval([], 1.5) == pytest.approx((-1.5, 1.5))
    assert pairs_until_decided([], 1.5) == math.inf
    assert pairs_until_decided([0.5, -0.5], 1.5) == math.inf


@pytest.mark.parametrize("wrong", [[1.1], [np.nan], [[0.5]]])
def test_differences_outside_their_range_are_refused(wrong):
    with pytest.raises(ValueError, match="differences"):
        betting_interval(wrong, 1.0)


@pytest.mark.parametrize(
    "draw",
    [
        lambda rng, size: rng.choice([-1.0, 0.0, 1.0], size, p=[0.3, 0.4, 0.3]),
        lambda rng, size: rng.choice([0.1, -0.9], size, p=[0.9, 0.1]),  # many small gains, a rare large loss
        lambda rng, size: rng.normal(0.0, 0.3, size).clip(-1.0, 1.0),
    ],
    ids=["holds", "skewed", "normal"],
)
def test_at_most_one_in_twenty_has_a_winner_where_there_is_none(draw):
    rng = np.random.default_rng(0)
    wrong = 0
    for differences in draw(rng, (500, PAIRS)):
        won = wealth(differences, 1.0).max() >= 40.0
        lost = wealth(-differences, 1.0).max() >= 40.0
        wrong += won or lost
    assert wrong <= 25


def test_a_t_test_at_every_look_would_err_more_often():
    # The control: what the promise above is for.
    from scipy.stats import ttest_1samp

    differences = np.random.default_rng(0).normal(0.0, 0.3, (500, PAIRS))
    wrong = np.zeros(500, bool)
    for look in LOOKS:
        wrong |= ttest_1samp(differences[:, :look], 0.0, axis=1).pvalue < 0.05
    assert wrong.mean() > 0.1
