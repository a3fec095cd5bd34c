"""A CleanRL model acts as PyTorch's module does: 1,000 observations recorded with PyTorch and Gymnasium's wrapper."""

from __future__ import annotations

import shutil
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from gymnasium.wrappers.utils import RunningMeanStd

import perdure
from perdure.errors import PerdureError
from perdure.policy import Policy, load_policy, save_policy
from perdure.policy.readers import checkpoints

FIXTURES = Path(__file__).parent / "fixtures"
MODEL = FIXTURES / "cleanrl.cleanrl_model"
TRUTH = np.load(FIXTURES / "cleanrl.npz")
STATISTICS = (TRUTH["mean"], TRUTH["var"])
NOW = np.zeros(1000)


@pytest.fixture(scope="module")
def policy():
    return Policy.from_cleanrl(MODEL, "Pendulum-v1", normalizer=STATISTICS, measure=False)


def test_actions_are_those_of_the_module(policy):
    found = policy.act(TRUTH["raw"], NOW)
    np.testing.assert_allclose(found, TRUTH["actions"], rtol=0, atol=1e-6)
    cut = np.abs(TRUTH["actions"]) == 2.0
    assert 0 < cut.mean() < 0.5, "some actions are cut to the box"


def test_values_are_those_of_its_critic(policy):
    np.testing.assert_allclose(policy.scaled_value(TRUTH["raw"], NOW, NOW), TRUTH["values"], rtol=0, atol=1e-6)


def test_without_its_statistics_it_acts_otherwise():
    raw = Policy.from_cleanrl(MODEL, "Pendulum-v1", normalizer="none", measure=False)
    assert np.abs(raw.act(TRUTH["raw"], NOW) - TRUTH["actions"]).max() > 0.1


def test_statistics_come_from_the_wrapper_itself_too(policy):
    running = RunningMeanStd(shape=(3,))
    running.mean, running.var = STATISTICS
    for given in (running, np.array(STATISTICS)):
        same = Policy.from_cleanrl(MODEL, "Pendulum-v1", normalizer=given, measure=False)
        assert np.array_equal(same.act(TRUTH["raw"], NOW), policy.act(TRUTH["raw"], NOW))


def test_statistics_come_from_a_file_too_and_the_policy_is_saved_and_evaluated(policy, tmp_path):
    path = tmp_path / "statistics.npz"
    np.savez(path, mean=STATISTICS[0], var=STATISTICS[1])
    same = Policy.from_cleanrl(MODEL, "Pendulum-v1", normalizer=path)
    assert same.reference is not None
    loaded = load_policy(save_policy(same, tmp_path / "policy.safetensors"))
    assert np.array_equal(loaded.act(TRUTH["raw"], NOW), policy.act(TRUTH["raw"], NOW))
    result = perdure.extrapolate(loaded, steps=300, eval_seeds=2, disturb="none")
    assert result.frame["policy"][0] == "CleanRL PPO (cleanrl)"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({}, r"does not hold the statistics.*obs_rms.*none"),
        ({"normalizer": (np.zeros(2), np.ones(2))}, r"3 finite numbers each.*\(2,\) and \(2,\)"),
        ({"normalizer": (np.zeros(3), [1.0, np.nan, 1.0])}, "3 finite numbers each"),
        ({"normalizer": (np.zeros(3), -np.ones(3))}, "not negative"),
        ({"normalizer": FIXTURES / "ppo.pkl"}, "npz file with the arrays mean and var"),
        ({"normalizer": np.zeros((3, 3))}, "must be a mean and a variance"),
        ({"normalizer": ("a mean", "a variance")}, "must be a mean and a variance"),
        ({"normalizer": object()}, "must be a mean and a variance"),
    ],
)
def test_wrong_statistics_are_refused(options, message):
    with pytest.raises(PerdureError, match=message):
        Policy.from_cleanrl(MODEL, "Pendulum-v1", **options)


@pytest.mark.parametrize("env", ["MountainCarContinuous-v0", "CartPole-v1"])
def test_another_environment_is_refused(env):
    with pytest.raises(PerdureError, match=env):
        Policy.from_cleanrl(MODEL, env, normalizer=STATISTICS)


def test_what_is_no_such_model_is_refused(tmp_path):
    cut = tmp_path / "cut.cleanrl_model"
    cut.write_bytes(MODEL.read_bytes()[:-500])
    with pytest.raises(PerdureError):
        Policy.from_cleanrl(cut, "Pendulum-v1", normalizer="none")
    shutil.copy(FIXTURES / "ppo.zip", tmp_path / "sb3.zip")
    with pytest.raises(PerdureError):
        Policy.from_cleanrl(tmp_path / "sb3.zip", "Pendulum-v1", normalizer="none")


def test_a_bias_without_a_dimension_is_one_number():
    """Its length is compared with that of the actions."""
    arrays = {"a.0.weight": np.zeros((1, 3)), "a.0.bias": np.zeros(())}
    state = SimpleNamespace(names=list(arrays), array=arrays.__getitem__)
    assert [each.shape for _, each in checkpoints._layers(state, "policy", "a", MODEL)] == [(3, 1), (1,)]
