"""Advantages against closed forms: what a step is worth, and what the end of an episode means for it.

Wherever the value function is exact, the advantage of every step is 0. So each exact value function is a probe, and
reading the same end in the wrong way is its negative control.
"""

from __future__ import annotations

from typing import ClassVar

import jax.numpy as jnp
import numpy as np
import pytest

from perdure.learn.advantages import Discounted, Ends, Transitions

STEPS = 12
NEVER = np.zeros(STEPS, bool)


def only(*steps):
    """True at these steps."""
    return np.isin(np.arange(STEPS), steps)


def estimate(
    rewards,
    values,
    last_values,
    *,
    horizon_terminates=False,
    gamma=0.9,
    gae_lambda=0.95,
    **steps_of_ends,
):
    """Advantages of one environment; all arguments in NumPy, shape (steps,), values one longer; flags as in `Ends`."""
    flags = {"terminated": NEVER, "truncated": NEVER, "horizon_end": NEVER, **steps_of_ends}
    ends = Ends(**{name: jnp.asarray(steps)[:, None] for name, steps in flags.items()})
    values, last_values, rewards = (jnp.asarray(x, jnp.float32)[:, None] for x in (values, last_values, rewards))
    rollout = Transitions(rewards, values, last_values, ends, jnp.ones_like(rewards))
    _, found = Discounted(gamma, gae_lambda, horizon_terminates).estimate((), rollout)
    return np.asarray(found.advantages)[:, 0]


class TestRewardOneForEver:
    """V = 1 / (1 - gamma) in every state, gamma = 0.9."""

    values = np.full(STEPS + 1, 10.0)
    episode: ClassVar = {"rewards": np.ones(STEPS), "values": values, "last_values": values[1:]}

    @pytest.mark.parametrize("gae_lambda", [0.0, 0.5, 0.95, 1.0])
    @pytest.mark.parametrize("cut", [{}, {"horizon_end": only(4, 9)}, {"truncated": only(4, 9)}])
    def test_a_bootstrap_at_the_limit_leaves_nothing_to_explain(self, cut, gae_lambda):
        np.testing.assert_allclose(estimate(**self.episode, **cut, gae_lambda=gae_lambda), 0.0, atol=1e-5)

    def test_the_limit_as_a_true_end_makes_up_a_loss_that_grows_towards_it(self):
        wrong = estimate(**self.episode, horizon_end=only(9), horizon_terminates=True)
        assert wrong[9] == pytest.approx(-9.0), "the step at the limit loses gamma V"
        assert np.all(np.diff(wrong[:10]) < 0)
        np.testing.assert_allclose(wrong[10:], 0.0, atol=1e-5, err_msg="the next episode is not touched")

    def test_an_end_the_engine_imposed_is_bootstrapped_whatever_the_horizon_means(self):
        np.testing.assert_allclose(estimate(**self.episode, truncated=only(9), horizon_terminates=True), 0.0, atol=1e-5)


class TestEveryStepPaysOneUntilTheHorizon:
    """Undiscounted, T = 6 twice in the rollout: V(t) = T - t, and nothing is left after the last step."""

    to_go = np.array([6, 5, 4, 3, 2, 1, 6, 5, 4, 3, 2, 1, 6], float)
    episode: ClassVar = {
        "rewards": np.ones(STEPS),
        "values": to_go,
        # The state after the last step has no steps to go; a network is never asked, so any number may stand there.
        "last_values": np.full(STEPS, 1e6),
        "horizon_end": only(5, 11),
        "gamma": 1.0,
    }

    @pytest.mark.parametrize("gae_lambda", [0.0, 0.5, 0.95, 1.0])
    def test_a_true_end_leaves_nothing_to_explain(self, gae_lambda):
        found = estimate(**self.episode, horizon_terminates=True, gae_lambda=gae_lambda)
        np.testing.assert_allclose(found, 0.0, atol=1e-5)

    def test_a_bootstrap_pays_for_steps_that_never_come(self):
        promised = {**self.episode, "last_values": np.full(STEPS, 3.0)}
        wrong = estimate(**promised, horizon_terminates=False, gae_lambda=1.0)
        np.testing.assert_allclose(wrong, 3.0, atol=1e-5)


class TestNumbersWorkedByHand:
    """gamma = 1/2; rewards 1, 2, 3; V = 4, 2, 8, then 6 after the rollout; no end.

    Temporal differences: 1 + 1 - 4 = -2; 2 + 4 - 2 = 4; 3 + 3 - 8 = -2.
    """

    rollout: ClassVar = {
        "rewards": [1.0, 2.0, 3.0],
        "values": [4.0, 2.0, 8.0, 6.0],
        "last_values": [100.0, 40.0, 100.0],
        "gamma": 0.5,
        "terminated": np.zeros(3, bool),
        "truncated": np.zeros(3, bool),
        "horizon_end": np.zeros(3, bool),
    }
    middle = np.array([False, True, False])

    def test_lambda_zero_gives_the_temporal_differences(self):
        np.testing.assert_allclose(estimate(**self.rollout, gae_lambda=0.0), [-2, 4, -2])

    def test_lambda_one_gives_discounted_returns_minus_values(self):
        # Returns 1 + 2/2 + 3/4 + 6/8 = 3.5; 2 + 3/2 + 6/4 = 5; 3 + 6/2 = 6.
        np.testing.assert_allclose(estimate(**self.rollout, gae_lambda=1.0), [-0.5, 3, -2])

    def test_lambda_one_half_halves_the_weight_of_each_later_difference_again(self):
        # -2; 4 - 2/4 = 3.5; -2 + 3.5/4 = -1.125.
        np.testing.assert_allclose(estimate(**self.rollout, gae_lambda=0.5), [-1.125, 3.5, -2])

    def test_a_fall_cuts_the_trace_and_is_worth_nothing_afterwards(self):
        # The fall: 2 - 2 = 0, and nothing of the third step reaches back.
        fallen = {**self.rollout, "terminated": self.middle}
        np.testing.assert_allclose(estimate(**fallen, gae_lambda=1.0), [-2, 0, -2])

    def test_a_cut_takes_the_value_of_the_last_observation_and_not_of_the_next_episode(self):
        # The cut: 2 + 40/2 - 2 = 20; the step before: -2 + 20/2 = 8.
        for kind in ("truncated", "horizon_end"):
            cut = {**self.rollout, kind: self.middle}
            np.testing.assert_allclose(estimate(**cut, gae_lambda=1.0), [8, 20, -2], err_msg=kind)

    def test_what_the_horizon_means_decides_between_the_two(self):
        limit = {**self.rollout, "horizon_end": self.middle}
        np.testing.assert_allclose(estimate(**limit, gae_lambda=1.0, horizon_terminates=True), [-2, 0, -2])

    @pytest.mark.parametrize("also", ["horizon_end", "truncated"])
    def test_a_fall_at_the_limit_is_a_fall(self, also):
        both = {**self.rollout, "terminated": self.middle, also: self.middle}
        np.testing.assert_allclose(estimate(**both, gae_lambda=1.0), [-2, 0, -2])

    def test_environments_do_not_mix(self):
        ends = Ends(*(jnp.array([[False, False], [flag, False], [False, False]]) for flag in (True, False, False)))
        values = jnp.array([[4.0, 4.0], [2.0, 2.0], [8.0, 8.0], [6.0, 6.0]])
        rewards = jnp.array([[1.0, 1.0], [2.0, 2.0], [3.0, 3.0]])
        rollout = Transitions(rewards, values, values[1:], ends, jnp.ones_like(rewards))
        _, found = Discounted(0.5, 1.0, horizon_terminates=False).estimate((), rollout)
        np.testing.assert_allclose(np.asarray(found.advantages).T, [[-2, 0, -2], [-0.5, 3, -2]])
