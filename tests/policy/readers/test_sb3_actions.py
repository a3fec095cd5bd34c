"""Imported policies act as Stable-Baselines3 does: the recorded actions are its own (`make_fixtures.py`)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import other_spaces
import pytest

from perdure.errors import PerdureError
from perdure.horizon import Constant, Countdown, Periodic
from perdure.policy import Policy, load_policy, save_policy

FIXTURES = Path(__file__).parent / "fixtures"
HORIZON = 50
TIMELESS = ("ppo", "ppo-sde", "a2c", "trpo", "sac", "sac-sde", "td3", "ddpg", "tqc", "ars", "ars-mlp")
OTHER_SPACES = {
    **dict.fromkeys(("dqn", "qrdqn", "ppo-discrete"), "Acrobot-v1"),
    "a2c-multidiscrete": other_spaces.TWO_GEARS,
    "ppo-onehot": "FrozenLake-v1",
    "sac-dict": other_spaces.DICT,
}
TIMED = ("ppo-time", "sac-time")


def imported(name, folder=FIXTURES, **options):
    normalizer = folder / f"{name}.pkl"
    options.setdefault("normalizer", normalizer if normalizer.exists() else "none")
    options.setdefault("time_feature", f"linear:{HORIZON}" if "time" in name else None)
    env = f"gymnasium:{OTHER_SPACES.get(name, 'Pendulum-v1')}"
    return Policy.from_sb3(folder / f"{name}.zip", env, measure=False, **options)


@pytest.fixture(scope="module")
def recorded():
    with np.load(FIXTURES / "actions.npz") as arrays:
        return dict(arrays)


@pytest.mark.parametrize("name", TIMELESS)
def test_actions_are_those_of_stable_baselines3(name, recorded, tmp_path):
    expected = recorded[name]
    assert len(expected) == 1000
    assert np.ptp(expected) > 0.02  # the network does something
    policy = imported(name)
    given = policy.act(recorded["observations"], np.zeros(1000))
    np.testing.assert_allclose(given, expected, rtol=0, atol=1e-6)
    again = load_policy(save_policy(policy, tmp_path / "policy"))
    np.testing.assert_array_equal(again.act(recorded["observations"], np.zeros(1000)), given)


@pytest.mark.parametrize("name", OTHER_SPACES)
def test_actions_in_other_spaces_are_those_of_stable_baselines3(name, recorded, tmp_path):
    """Discrete ones are equal; of several components, and from whole numbers or a dictionary as observations."""
    expected = recorded[name].reshape(1000, -1)
    assert len(np.unique(expected, axis=0)) > 1
    policy = load_policy(save_policy(imported(name), tmp_path / "policy"))
    given = policy.act(recorded[f"{name}-observations"], np.zeros(1000))
    np.testing.assert_allclose(given, expected, rtol=0, atol=1e-6)


def test_discrete_models_are_refused_where_their_choices_do_not_fit():
    for name, env in (("dqn", "CartPole-v1"), ("qrdqn", "Pendulum-v1"), ("trpo", other_spaces.TWO_GEARS)):
        with pytest.raises(PerdureError, match=r"takes \d+ numbers|actions are"):
            Policy.from_sb3(FIXTURES / f"{name}.zip", f"gymnasium:{env}", normalizer="none", measure=False)


@pytest.mark.filterwarnings("ignore::perdure.errors.PerdureWarning")
@pytest.mark.parametrize("name", TIMED)
@pytest.mark.parametrize(("mode", "clock"), [("countdown", None), ("test_mode", Constant(float(HORIZON)))])
def test_actions_with_a_time_feature_are_those_of_the_wrapper_far_beyond_its_horizon(name, mode, clock, recorded):
    expected = recorded[f"{name}-{mode}"]
    given = imported(name).act(recorded[f"{name}-{mode}-observations"], np.arange(1000.0), clock)
    np.testing.assert_allclose(given, expected, rtol=0, atol=1e-6)


@pytest.mark.filterwarnings("ignore::perdure.errors.PerdureWarning")
@pytest.mark.parametrize("name", TIMED)
def test_other_clocks_give_other_actions(name, recorded):
    """The control of the test above: the time feature matters."""
    policy, observations = imported(name), recorded[f"{name}-countdown-observations"]
    for clock in (Constant(0.0), Constant(float(HORIZON)), Periodic(float(HORIZON)), Countdown(2.0 * HORIZON)):
        difference = policy.act(observations, np.arange(1000.0), clock) - recorded[f"{name}-countdown"]
        assert np.abs(difference).max() > 1e-3


def test_without_squashing_or_statistics_actions_differ(recorded):
    """Controls: what the file says about output and normalizer is used."""
    from dataclasses import replace

    zeros = np.zeros(1000)
    for name in ("sac", "td3", "tqc", "ppo-sde"):
        clipped = replace(imported(name), squash=None)
        assert np.abs(clipped.act(recorded["observations"], zeros) - recorded[name]).max() > 1e-3
    for name in ("ppo", "a2c", "tqc", "sac-sde"):
        raw = imported(name, normalizer="none")
        assert np.abs(raw.act(recorded["observations"], zeros) - recorded[name]).max() > 1e-3


@pytest.mark.parametrize("name", ["ppo", "a2c", "sac", "trpo", "td3"])
def test_an_action_does_not_depend_on_the_rows_beside_it(name, recorded):
    """Every activation function of the fixtures: tanh, SiLU, GELU, ELU, leaky ReLU."""
    policy, rows = imported(name), recorded["observations"]
    whole = policy.act(rows, np.zeros(1000))
    for size in (1, 2, 7, 33):
        chosen = np.random.default_rng(size).choice(1000, size, replace=False)
        np.testing.assert_array_equal(policy.act(rows[chosen], np.zeros(size)), whole[chosen])
