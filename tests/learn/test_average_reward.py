"""Average-reward PPO: estimates in closed form, a probe world with a known average reward, checkpoints."""

from __future__ import annotations

from dataclasses import replace

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from perdure.errors import PerdureError
from perdure.horizon import Fixed, HorizonProtocol
from perdure.learn import PPOConfig, TrainRun, method_config, train
from perdure.learn.advantages import AverageReward, Ends, Transitions, make_estimator
from perdure.learn.checkpoint import load_checkpoint, save_checkpoint
from perdure.learn.run import Segments
from perdure.policy import load_policy

CUT = HorizonProtocol(embedding=None, horizon=Fixed(50), end="truncated", gamma=1.0, normalizer_gamma=0.9)


def transitions(rewards, values, last_values=None, terminated=(), cut=(), return_std=1.0):
    """One environment's rollout; `terminated` and `cut` are the steps that ended so."""
    n = len(rewards)
    column = lambda numbers: jnp.asarray(numbers, jnp.float32).reshape(-1, 1)  # noqa: E731
    flags = lambda steps: jnp.asarray([[k in steps] for k in range(n)])  # noqa: E731
    ends = Ends(flags(terminated), flags(()), flags(cut))
    last_values = values[1:] if last_values is None else last_values
    return Transitions(column(rewards), column(values), column(last_values), ends, jnp.full((n, 1), return_std))


def estimate(estimator, *args, **kwargs):
    state, found = estimator.estimate(estimator.start(), transitions(*args, **kwargs))
    return state, np.asarray(found.advantages)[:, 0], np.asarray(found.targets)[:, 0]


@pytest.mark.parametrize(("change", "name"), [({"end": "terminated"}, "end"), ({"gamma": 0.99}, "gamma")])
def test_a_protocol_that_discounts_or_ends_at_its_horizon_is_refused(change, name):
    with pytest.raises(PerdureError, match=rf"average-reward needs protocol\.{name}"):
        PPOConfig(protocol=replace(CUT, **change), estimator="average-reward")


class TestEstimates:
    def test_right_values_of_a_world_with_two_states_have_no_advantage(self):
        """Rewards 0, 2, 0, 2, ... earn 1 a step; V(0) = 0 - 1 + V(1), so V(1) - V(0) = 1."""
        rewards, values = [0.0, 2.0] * 10, [-0.5, 0.5] * 10 + [-0.5]
        state, advantages, targets = estimate(AverageReward(0.95), rewards, values)
        assert float(state.rate) == 1.0
        assert float(state.value) == pytest.approx(0.0, abs=0.03)
        np.testing.assert_allclose(advantages, 0.0, atol=1e-6)
        np.testing.assert_allclose(targets, values[:-1], atol=0.01)

    def test_wrong_values_of_that_world_have_one(self):
        _, advantages, _ = estimate(AverageReward(0.0), [0.0, 2.0] * 10, [0.0] * 21)
        np.testing.assert_allclose(advantages, [-1.0, 1.0] * 10, atol=1e-6)

    def test_a_fall_costs_and_the_next_episode_follows_it(self):
        """Five steps pay 1, the fifth falls at a cost of 10 in units where rewards are divided by 2: -1 a step."""
        rewards = [0.5] * 10
        state, advantages, _ = estimate(
            AverageReward(0.95, reset_cost=10.0),
            rewards,
            [0.0, -1.0, -2.0, -3.0, -4.0] * 2 + [0.0],
            last_values=[99.0] * 10,  # what a fall led to is of no account
            terminated=(4, 9),
            return_std=2.0,
        )
        assert float(state.rate) == pytest.approx((2.5 - 5.0) / 5)
        np.testing.assert_allclose(advantages, 0.0, atol=1e-5)

    def test_an_episode_that_was_cut_goes_on_in_thought(self):
        estimator = AverageReward(1.0)
        _, cut, _ = estimate(estimator, [0.0, 0.0], [0.0, 7.0, 0.0], last_values=[3.0, 0.0], cut=(0,))
        _, whole, _ = estimate(estimator, [0.0, 0.0], [0.0, 7.0, 0.0], last_values=[3.0, 0.0])
        assert cut.tolist() == [3.0, -7.0]
        assert whole.tolist() == [0.0, -7.0]

    def test_averages_move_by_alpha_and_the_constraint_pulls_values_down(self):
        estimator = AverageReward(0.95, alpha=0.25, nu=0.5)
        state = estimator.start()
        for _ in range(10):
            state, _ = estimator.estimate(state, transitions([1.0] * 4, [8.0] * 5))
        state, found = estimator.estimate(state, transitions([5.0] * 4, [8.0] * 5))
        assert float(state.rate) == pytest.approx(0.75 * 1 + 0.25 * 5)
        difference = np.asarray(found.targets - found.advantages)
        np.testing.assert_allclose(difference, 8.0 - 0.5 * 8.0, rtol=1e-6)

    def test_the_state_after_the_rollout_is_not_one_of_its_states(self):
        estimator = AverageReward(0.95, alpha=0.25)
        state, _ = estimator.estimate(estimator.start(), transitions([1.0] * 4, [2.0] * 4 + [100.0]))
        assert float(state.value) == pytest.approx(2.0)

    def test_a_fall_costs_100_unless_another_cost_is_named(self):
        assert AverageReward(0.95).reset_cost == 100.0


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("average", "did you mean 'average-reward'"),
        ("average-reward:alfa=1", "unknown number 'alfa'.* the numbers of average-reward are alpha, nu, reset_cost"),
        ("average-reward:alpha=2", "alpha"),
        ("average-reward:alpha", "name=number"),
        ("average-reward:reset_cost=inf", "reset_cost"),
        ("average-reward:gae_lambda=1", "unknown number 'gae_lambda'"),
        ("discounted:nu=1", "unknown number 'nu'.* discounted has no numbers"),
    ],
)
def test_an_estimator_that_is_none_is_refused_by_name(text, named):
    with pytest.raises(PerdureError, match=named):
        PPOConfig(estimator=text)


def test_other_methods_are_written_as_before():
    assert "estimator" not in method_config("ppo", "Swimmer-v3", 8).to_json()
    config = method_config("ppo-average-reward", "Swimmer-v3", 8)
    assert isinstance(make_estimator(config), AverageReward)


class Orchard(gymnasium.Env):
    """Planting a tree costs 1 now and pays 2.5 five steps later; the action plants between none and one.

    It earns 1.5 a step in the long run. With gamma = 0.8 a tree is worth 2.5 * 0.8^5 = 0.82, less than it costs.
    """

    observation_space = gymnasium.spaces.Box(-1.0, 1.0, (1,), np.float64)
    action_space = gymnasium.spaces.Box(-1.0, 1.0, (1,), np.float64)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.trees = [0.0] * 5
        return np.zeros(1), {}

    def step(self, action):
        planted = (float(action[0]) + 1) / 2
        self.trees.append(planted)
        return np.zeros(1), 2.5 * self.trees[-6] - planted, False, False, {}


@pytest.fixture(scope="module", autouse=True)
def registered():
    gymnasium.register("perdure-Orchard-v0", Orchard)
    yield
    del gymnasium.registry["perdure-Orchard-v0"]


SMALL = {"n_envs": 4, "n_steps": 128, "batch_size": 128, "hidden_sizes": (16,), "learning_rate": 5e-3}


def planted(policy):
    (action,) = policy.act(np.zeros((1, 1)), np.zeros(1), None)
    return (float(action[0]) + 1) / 2


@pytest.mark.verify
def test_a_discount_does_not_learn_what_pays_in_the_long_run(tmp_path):
    discounted = HorizonProtocol(None, Fixed(50), "truncated", gamma=0.8, normalizer_gamma=0.9)
    config = PPOConfig(protocol=discounted, estimator="discounted", total_steps=512 * 16, **SMALL)
    (path,) = train(TrainRun("gymnasium:perdure-Orchard-v0", "probe", config), tmp_path, cores=1)
    assert planted(load_policy(path)) < 0.1


@pytest.mark.verify
def test_what_pays_in_the_long_run_is_learned_and_the_average_reward_found_across_a_checkpoint(tmp_path):
    config = PPOConfig(protocol=CUT, estimator="average-reward", total_steps=512 * 16, segment_steps=512 * 8, **SMALL)
    segments = Segments("gymnasium:perdure-Orchard-v0", config, threads=1)
    start = segments.first(0)
    state = segments.run(segments.first(0), lambda step, facts: None)
    save_checkpoint(state, tmp_path / "c")
    read = load_checkpoint(tmp_path / "c", start)
    assert jax.tree.map(float, read.learner.estimator) == jax.tree.map(float, state.learner.estimator)
    assert float(read.learner.estimator.rollouts) == 8
    ended = segments.run(read, lambda step, facts: None)
    assert planted(segments.algorithm.policy(ended.learner)) > 0.9
    scale = np.sqrt(float(ended.learner.statistics.returns.var[0]))
    # The last rollouts earn nearly 1.5 less what the noise of exploration costs.
    assert 0.8 < float(ended.learner.estimator.rate) * scale < 1.5
