"""Mechanism measures against numbers worked out by hand, and policies whose dependence on the time is known."""

import numpy as np
import pytest
from tiny_study import pendulum_policy

from perdure.horizon import Constant, Fixed, Geometric, HorizonProtocol, Linear, Uniform
from studies.horizon.rollouts import (
    Rollout,
    draw_horizons,
    has_target,
    returns_to_go,
    rewards_to_go,
    roll_out,
    tail_steps,
    value_measures,
)

LINEAR = Linear()
GEOMETRIC = Geometric(2)  # phi = (0.99^(T-t), 1)


def protocol(end="terminated", gamma=1.0, horizon=None, embedding=GEOMETRIC):
    return HorizonProtocol(embedding, horizon or Fixed(4), end, gamma, 1.0)


def timed_policy(**parts):
    return pendulum_policy(protocol(**parts), Constant(500.0))


def rollout(rewards, lengths):
    rewards = np.asarray(rewards, float).T
    return Rollout(np.zeros((*rewards.shape, 4)), rewards, np.array(lengths))


TWO = rollout([[1, 2, 3, 4, 5], [1, 1, 0, 0, 0]], [5, 2])
HORIZONS = np.array([4, 4])


def test_returns_to_go_end_at_the_horizon_where_it_terminates():
    found = returns_to_go(timed_policy(), TWO, HORIZONS)
    assert found[:, 0].tolist() == [10, 9, 7, 4, 0]
    assert found[:, 1].tolist() == [2, 1, 0, 0, 0]


def test_returns_to_go_are_discounted_and_go_on_where_it_is_bootstrapped():
    found = returns_to_go(timed_policy(end="truncated", gamma=0.5), TWO, HORIZONS)
    assert found[:, 0].tolist() == [1 + 1 + 0.75 + 0.5 + 5 / 16, 2 + 1.5 + 1 + 5 / 8, 3 + 2 + 5 / 4, 4 + 2.5, 5]


def test_rewards_are_averaged_within_the_horizon():
    table = rewards_to_go(TWO, HORIZONS)
    assert table.to_dict(as_series=False) == {"steps to go": [50], "reward": [12 / 6]}


def test_steps_to_go_are_counted_in_bins_of_fifty():
    long = rollout([np.arange(120.0)], [120])
    table = rewards_to_go(long, np.array([101]))
    assert table["steps to go"].to_list() == [50, 100, 150]
    assert table["reward"].to_list() == [np.arange(51, 101).mean(), np.arange(1, 51).mean(), 0.0]


def test_a_critic_that_is_right_leaves_no_variance():
    """Each step pays 1 and nobody falls, so the value is the steps to go: 4 times the linear phi, (T - t) / T."""
    steady = rollout([np.ones(4)] * 2, [4, 4])
    right = pendulum_policy(protocol(embedding=LINEAR), Constant(500.0), value=(4.0,))
    found = value_measures(right, steady, HORIZONS)
    assert found["value variance"] == pytest.approx(0.0, abs=1e-9)


def test_a_critic_that_says_0_leaves_all_variance():
    steady = rollout([np.ones(4)] * 2, [4, 4])
    wrong = value_measures(timed_policy(), steady, HORIZONS)
    assert wrong["value variance"] == pytest.approx(1.0)


def test_a_constant_critic_explains_no_variance():
    right = rollout([np.ones(4)] * 2, [4, 4])
    constant = pendulum_policy(protocol(), Constant(500.0), value=(0.0, 2.5))
    found = value_measures(constant, right, HORIZONS)
    assert found["value variance"] == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("parts", "expected"),
    [
        ({}, True),
        ({"end": "truncated", "gamma": 0.9}, True),
        ({"end": "truncated", "gamma": 0.999}, False),  # rewards of 4,603 steps count
        ({"end": "truncated", "gamma": 1.0}, False),
    ],
)
def test_a_bootstrapped_value_without_a_short_memory_has_nothing_to_compare(parts, expected):
    assert has_target(timed_policy(**parts)) is expected


def test_the_tail_is_as_long_as_rewards_count():
    assert tail_steps(timed_policy(end="truncated", gamma=0.9)) == 44  # 0.9^44 = 0.0097
    assert tail_steps(timed_policy(end="truncated", gamma=0.999)) == 4603
    assert tail_steps(timed_policy()) == 0


def test_horizons_cover_their_distribution_evenly():
    assert draw_horizons(timed_policy(horizon=Uniform(200, 1000)), 8).tolist() == [250 + 100 * k for k in range(8)]


def test_a_rollout_counts_the_steps_it_made():
    falling = pendulum_policy(protocol(), Constant(500.0), push=(0.0, 30.0))
    found = roll_out(falling, [Constant(500.0)] * 2, 300)
    assert (found.lengths < 300).all()
    assert found.made.sum() == found.lengths.sum()
    assert np.isnan(found.observations[-1]).all()
