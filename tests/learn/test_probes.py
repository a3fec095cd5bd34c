"""The whole learner on tasks whose optimum and values are known."""

from __future__ import annotations

import gymnasium
import numpy as np
import polars as pl
import pytest

from perdure.horizon import Countdown, Fixed, Geometric, HorizonProtocol, Uniform
from perdure.learn import PPOConfig, TrainRun, train
from perdure.policy import load_policy


class Probe(gymnasium.Env):
    """Shows nothing but 0. Its one action is a number in [-1, 1]."""

    observation_space = gymnasium.spaces.Box(-1.0, 1.0, (1,), np.float64)
    action_space = gymnasium.spaces.Box(-1.0, 1.0, (1,), np.float64)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.shares = 0.0
        return np.zeros(1), {}

    def step(self, action):
        return np.zeros(1), self.reward(float(action[0])), False, False, {}

    def reward(self, action):
        raise NotImplementedError


class Wage(Probe):
    """Pays 1 at every step, whatever is done."""

    def reward(self, action):
        return 1.0


class Shares(Probe):
    """A share costs 2.5 and pays 1 at every later step; the action buys between none and one.

    Worth it while more than 2.5 steps follow: over T = 6 steps the first three gain 2.5 + 1.5 + 0.5 = 4.5, the others
    lose as much. Who does not know the time can only buy the same at every step, which gains nothing.
    """

    COST, HORIZON, OPTIMUM = 2.5, 6, 4.5

    def reward(self, action):
        bought = (action + 1) / 2
        paid = self.shares - self.COST * bought
        self.shares += bought
        return paid


@pytest.fixture(scope="module", autouse=True)
def registered():
    for kind in (Wage, Shares):
        gymnasium.register(f"perdure-{kind.__name__}-v0", kind)
    yield
    for kind in (Wage, Shares):
        del gymnasium.registry[f"perdure-{kind.__name__}-v0"]


def trained(kind, embedding, law, store, **settings):
    """The policy and the episodes of a short run; gamma = 1 and the limit is a true end."""
    protocol = HorizonProtocol(embedding, law, "terminated", gamma=1.0, normalizer_gamma=1.0)
    usual = {"n_envs": 4, "n_steps": 128, "batch_size": 128, "hidden_sizes": (16,), "learning_rate": 5e-3}
    config = PPOConfig(protocol=protocol, **(usual | settings))
    (path,) = train(TrainRun(f"gymnasium:perdure-{kind.__name__}-v0", "probe", config), store, cores=1)
    return load_policy(path), pl.read_parquet(path.with_name("episodes.parquet"))


LOW, HIGH = 3, 9


@pytest.fixture(scope="module")
def wage(tmp_path_factory):
    """A run on the wage, its horizon drawn anew for each episode."""
    return trained(Wage, Geometric(4, low=0.5), Uniform(LOW, HIGH), tmp_path_factory.mktemp("w"), total_steps=512 * 14)


class TestAWageUnderARandomHorizon:
    def test_the_value_is_proportional_to_the_time_to_go(self, wage):
        """Rewards are scaled by a number that the file does not keep, so values are compared with each other."""
        policy, _ = wage
        to_go = np.arange(1.0, HIGH + 1)
        values = policy.scaled_value(np.zeros((HIGH, 1)), np.zeros(HIGH), to_go)
        scale = (values @ to_go) / (to_go @ to_go)
        np.testing.assert_allclose(values, scale * to_go, rtol=0, atol=0.1 * values.max())

    def test_the_value_depends_on_what_is_left_and_not_on_what_has_passed(self, wage):
        policy, _ = wage
        early, late = policy.scaled_value(np.zeros((2, 1)), np.array([0.0, 5.0]), np.array([4.0, 9.0]))
        assert early == late

    def test_episode_lengths_follow_the_law(self, wage):
        _, episodes = wage
        lengths = episodes["length"].to_numpy()
        assert set(lengths) == set(range(LOW, HIGH + 1))
        # Seven equally likely lengths around 6 with standard deviation 2: four standard errors.
        assert abs(lengths.mean() - 6) < 4 * 2 / np.sqrt(len(lengths))
        counts = np.array([(lengths == length).sum() for length in range(LOW, HIGH + 1)])
        assert np.all(np.abs(counts - len(lengths) / 7) < 4 * np.sqrt(len(lengths) / 7))

    def test_each_episode_earned_its_length(self, wage):
        _, episodes = wage
        assert (episodes["return"] == episodes["length"]).all()


def gain(act):
    """What a deterministic policy earns in one episode; `act(observation, step)` gives its action."""
    env = Shares()
    observation, _ = env.reset()
    total = 0.0
    for step in range(Shares.HORIZON):
        observation, reward, *_ = env.step(act(observation, step))
        total += reward
    return total


@pytest.mark.parametrize("conditioning", ["concatenate", pytest.param("film", marks=pytest.mark.verify)])
def test_a_task_whose_best_action_depends_on_the_time_to_go_is_solved_with_phi(tmp_path, conditioning):
    phi, law = Geometric(4, low=0.5), Fixed(Shares.HORIZON)
    policy, _ = trained(Shares, phi, law, tmp_path, total_steps=512 * 30, conditioning=conditioning)
    assert ("policy.0.scale" in policy.weights) == (conditioning == "film")
    clock = Countdown(float(Shares.HORIZON))
    told = gain(lambda observation, step: policy.act(observation[None], np.array([float(step)]), clock)[0])
    assert told > 0.9 * Shares.OPTIMUM
    same = gain(lambda observation, step: policy.act(observation[None], np.zeros(1), clock)[0])
    assert same == pytest.approx(0.0, abs=1e-6), "the control: who buys the same at every step gains nothing"
