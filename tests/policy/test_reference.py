"""What a policy does within its training horizon: a world with a known answer, and Gymnasium's own loop on Hopper."""

from __future__ import annotations

import dataclasses
from functools import partial

import gymnasium
import numpy as np
import pytest
from make_policy import HOPPER, random_policy

from perdure.envs import GymnasiumWorld, make_world
from perdure.errors import PerdureError
from perdure.horizon import Constant, Countdown, Fixed, HorizonProtocol, TimeFeature
from perdure.policy import (
    ClosedLoop,
    EpisodePolicy,
    Normalizer,
    Policy,
    TaskInfo,
    load_policy,
    measure_reference,
    save_policy,
)
from perdure.policy.reference import BIN_STEPS, FIRST_SEED


class Ramp(gymnasium.Env):
    """Pays its step number; falls after `last` steps."""

    observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (1,))
    action_space = gymnasium.spaces.Box(-1.0, 1.0, (1,))

    def __init__(self, last):
        self.last = last

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.elapsed = 0
        return np.zeros(1), {}

    def step(self, action):
        self.elapsed += 1
        return np.full(1, float(-self.elapsed)), float(self.elapsed), self.elapsed == self.last, False, {}


RAMP = TaskInfo("ramp", 1, (-1.0,), (1.0,))


def ramp_policy(horizon):
    protocol = HorizonProtocol(None, Fixed(horizon), "truncated", 0.99, 0.99)
    return dataclasses.replace(
        random_policy(task=RAMP, embedding=None), protocol=protocol, provenance={"method": "ppo", "seed": 0}
    )


def measure_ramps(horizon, *lasts):
    world = GymnasiumWorld([partial(Ramp, last) for last in lasts], list(range(len(lasts))))
    return measure_reference(ramp_policy(horizon), len(lasts), world)


def test_rewards_lengths_falls_and_ranges_of_a_known_world():
    found = measure_ramps(25, 7, 1000, 25)
    assert found.lengths.tolist() == [7, 25, 25]
    assert found.terminated.tolist() == [True, False, True]
    assert found.returns.tolist() == [sum(range(8)), sum(range(26)), sum(range(26))]
    assert found.rewards.shape == (3, 3)
    assert found.rewards[1].tolist() == [sum(range(1, 11)), sum(range(11, 21)), sum(range(21, 26))]
    assert found.rewards[0, 1:].tolist() == [0, 0]
    assert (found.observation_low.tolist(), found.observation_high.tolist()) == ([-25.0], [0.0])
    assert found.rate == (28 + 2 * 325) / 57


def test_an_environment_whose_episode_starts_with_nan_is_named():
    class Broken(Ramp):
        def reset(self, **options):
            super().reset(**options)
            return np.full(1, np.nan), {}

    def world():
        return GymnasiumWorld([partial(Broken, 1000)], [0], "broken")

    policy = ramp_policy(25)
    with pytest.raises(PerdureError, match=r"observation\[0\] = nan"):
        measure_reference(policy, 1, world())
    with pytest.raises(PerdureError, match=r"observation\[0\] = nan"):
        ClosedLoop(world(), [EpisodePolicy(policy, policy.clock)])


def test_a_time_feature_counts_down_from_its_own_steps_however_short_the_episodes():
    """sb3-contrib's wrapper shows 1 - t/N. The action is phi, which the world records."""
    seen = []

    class Recording(Ramp):
        def step(self, action):
            seen.append(float(action[0]))
            return super().step(action)

    protocol = HorizonProtocol(TimeFeature(100), Fixed(5), "truncated", 0.99, 0.99)
    weights = {"policy.0.weight": np.array([[0.0], [1.0]]), "policy.0.bias": np.zeros(1), "log_std": np.zeros(1)}
    weights |= {"value.0.weight": np.zeros((2, 1)), "value.0.bias": np.zeros(1)}
    policy = Policy(
        task=RAMP,
        weights={name: array.astype(np.float32) for name, array in weights.items()},
        activation="tanh",
        normalizer=Normalizer(np.zeros(1), np.ones(1)),
        protocol=protocol,
        clock=Countdown(100.0),
    )
    measure_reference(policy, 1, GymnasiumWorld([partial(Recording, 1000)], [0]))
    assert seen == pytest.approx([1.0, 0.99, 0.98, 0.97, 0.96])
    seen.clear()
    measure_reference(
        dataclasses.replace(policy, clock=Constant(5)), 1, GymnasiumWorld([partial(Recording, 1000)], [0])
    )
    assert seen == pytest.approx([0.05, 0.04, 0.03, 0.02, 0.01]), "trained by perdure: it saw the steps left of T"


def test_a_policy_with_time_to_go_is_told_the_countdown_of_training():
    policy = random_policy(seed=3)
    found = measure_reference(policy, 2)
    world = make_world("Hopper-v3", [FIRST_SEED, FIRST_SEED + 1])
    observations, returns, living = world.reset(), np.zeros(2), np.arange(2)
    for elapsed in range(1000):
        actions = policy.act(observations, np.full(len(living), elapsed), clock=Countdown(1000.0))
        step = world.step(actions, living)
        returns[living] += step.rewards
        observations, living = step.observations[~step.ended], living[~step.ended]
        if not len(living):
            break
    world.close()
    np.testing.assert_allclose(found.returns, returns, rtol=1e-12)
    assert found.horizon == 1000
    assert found.rewards.shape == (2, 1000 // BIN_STEPS)


def test_the_measurement_comes_back_from_the_file_bit_for_bit(tmp_path):
    policy = dataclasses.replace(ramp_policy(25), reference=measure_ramps(25, 7, 30), return_scale=3.5)
    loaded = load_policy(save_policy(policy, tmp_path / "p"))
    assert loaded.return_scale == 3.5
    for field in dataclasses.fields(policy.reference):
        one, other = getattr(loaded.reference, field.name), getattr(policy.reference, field.name)
        assert np.array_equal(one, other), field.name
    assert save_policy(loaded, tmp_path / "q").read_bytes() == (tmp_path / "p").read_bytes()
    assert not any("reference" in name for name in loaded.weights)


def test_without_a_scale_values_are_in_scaled_units_only():
    with pytest.raises(PerdureError, match="scaled_value"):
        random_policy(return_scale=None).value(np.zeros((1, 11)), np.zeros(1), np.full(1, 1000.0))


def test_the_value_is_in_reward_units_where_the_scale_is_known():
    policy = random_policy(return_scale=2.5)
    arguments = np.ones((3, 11)), np.zeros(3), np.full(3, 1000.0)
    assert np.array_equal(policy.value(*arguments), 2.5 * policy.scaled_value(*arguments))


@pytest.mark.parametrize("scale", [0, -1.0, float("nan"), float("inf"), "2"])
def test_a_scale_that_is_no_positive_number_is_refused(scale):
    with pytest.raises(PerdureError, match="return_scale"):
        random_policy(return_scale=scale)


@pytest.mark.parametrize(
    "change",
    [
        {"horizon": 5},
        {"lengths": np.array([7, 0])},
        {"lengths": np.array([7, 26])},
        {"rewards": np.full((2, 3), np.nan)},
        {"rewards": np.zeros((2, 4))},
        {"observation_low": np.array([1.0])},
        {"terminated": np.zeros(3, bool)},
    ],
)
def test_arrays_that_do_not_fit_together_are_refused(change):
    with pytest.raises(PerdureError, match="reference"):
        dataclasses.replace(measure_ramps(25, 7, 30), **change)


def test_a_reference_of_another_task_is_refused():
    with pytest.raises(PerdureError, match="components"):
        random_policy(task=HOPPER, reference=measure_ramps(25, 7, 30))
