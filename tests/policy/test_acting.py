"""Acting: each row by itself, bit for bit; in NumPy what the learner computes in JAX."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from make_policy import random_policy

from perdure.errors import PerdureError
from perdure.horizon import Constant, Countdown, LaneClocks, Periodic
from perdure.policy import TaskInfo
from perdure.policy.network import TILES

ROWS = 3 * max(TILES) + 5
RNG = np.random.default_rng(1)
OBSERVATIONS = RNG.normal(size=(ROWS, 11)) * 3
CLOCKS = [(Constant(500.0), Periodic(200.0), Countdown(100_000.0), Constant(0.0))[i % 4] for i in range(ROWS)]
ELAPSED = RNG.integers(0, 100_000, ROWS).astype(float)
POLICIES = {kind: random_policy(activation=kind, hidden=(64, 64)) for kind in ("relu", "tanh")}
POLICIES["film"] = random_policy(hidden=(64, 64), film=True)


def act(policy, rows):
    times = LaneClocks([CLOCKS[row] for row in rows]).time(ELAPSED[rows])
    return policy.act_at(OBSERVATIONS[rows], *times)


@pytest.mark.parametrize("kind", POLICIES)
@given(rows=st.lists(st.integers(0, ROWS - 1), min_size=1, max_size=ROWS))
@settings(max_examples=100, deadline=None)
def test_a_rows_action_does_not_depend_on_the_other_rows_their_number_or_their_order(kind, rows):
    policy = POLICIES[kind]
    np.testing.assert_array_equal(act(policy, rows), act(policy, list(range(ROWS)))[rows])


def test_rows_under_different_clocks_get_different_actions():
    same = np.repeat(OBSERVATIONS[:1], 4, axis=0)
    actions = POLICIES["tanh"].act_at(same, *LaneClocks(CLOCKS[:4]).time(np.full(4, 250.0)))
    assert len(np.unique(actions, axis=0)) == 4


@pytest.mark.parametrize("hidden", [(8,), (64, 64), (256, 256), (30, 7)])
def test_a_row_gets_the_same_action_at_every_place_of_the_batch(hidden):
    """Some libraries add up the rows of one product in different orders, depending on where in it they lie."""
    policy = random_policy(hidden=hidden)
    for row in OBSERVATIONS[:10]:
        actions = policy.act(np.tile(row, (ROWS, 1)), np.zeros(ROWS))
        assert len(np.unique(actions, axis=0)) == 1


@pytest.mark.parametrize("activation", ["relu", "tanh"])
@pytest.mark.parametrize(
    "kind", [{"embedding": "geometric"}, {"embedding": None}, {"normalize_embedding": True}, {"film": True}]
)
def test_numpy_acting_and_values_agree_with_the_learners_forward_pass(activation, kind):
    import jax.numpy as jnp

    from perdure.learn.networks import forward

    policy = random_policy(activation=activation, hidden=(32, 32), **kind)
    inputs = policy.inputs(OBSERVATIONS, policy.embed(ELAPSED, np.full(ROWS, 1000.0)))
    params = {name: jnp.asarray(weight) for name, weight in policy.weights.items()}
    mean = np.asarray(forward(params, "policy", jnp.asarray(inputs), activation))
    values = np.asarray(forward(params, "value", jnp.asarray(inputs), activation))[:, 0]
    times = ELAPSED, np.full(ROWS, 1000.0)
    assert (np.abs(mean) > 1).any(), "no action reaches the box: the test would not see a missing cut"
    np.testing.assert_allclose(policy.act_at(OBSERVATIONS, *times), np.clip(mean, -1, 1), rtol=0, atol=1e-5)
    np.testing.assert_allclose(policy.scaled_value(OBSERVATIONS, *times), values, rtol=0, atol=1e-5)


def test_a_modulated_layer_is_the_equation_of_the_paper():
    """One hidden layer by hand, from the policy's own weights: (1 + phi S) (h W + b) + phi T."""
    policy = random_policy(hidden=(8,), film=True)
    w, phi = policy.weights, policy.embed(ELAPSED, np.full(ROWS, 1000.0))
    seen = policy.inputs(OBSERVATIONS, phi)[:, :11].astype(np.float64)
    sums = seen @ w["policy.0.weight"] + w["policy.0.bias"]
    hidden = np.tanh((1 + phi @ w["policy.0.scale"]) * sums + phi @ w["policy.0.shift"])
    expected = np.clip(hidden @ w["policy.1.weight"] + w["policy.1.bias"], -1, 1)
    found = policy.act_from(policy.inputs(OBSERVATIONS, phi))
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-5)
    unmodulated = np.clip(np.tanh(sums) @ w["policy.1.weight"] + w["policy.1.bias"], -1, 1)
    assert np.abs(found - unmodulated).max() > 0.1, "the control: modulation matters here"


def test_modulation_by_a_part_of_the_observation_is_refused():
    """Ten numbers go through the first layer and six modulate: the sum fits eleven of the robot and five of phi."""
    policy = random_policy(film=True)
    changed = {
        name: np.vstack([each, each[:1]])
        if name.endswith(("scale", "shift"))
        else each[:-1]
        if ".0.weight" in name
        else each
        for name, each in policy.weights.items()
    }
    with pytest.raises(PerdureError, match=r"5.*6"):
        dataclasses.replace(policy, weights=changed)


def test_modulation_of_zero_is_none():
    """As training begins: the policy acts as one that does not see phi."""
    policy = random_policy(film=True)
    zeros = {name: 0 * each if name.endswith(("scale", "shift")) else each for name, each in policy.weights.items()}
    start = dataclasses.replace(policy, weights=zeros)
    early, late = (start.act_at(OBSERVATIONS, np.full(ROWS, t), np.full(ROWS, 1000.0)) for t in (0.0, 999.0))
    np.testing.assert_array_equal(early, late)
    early, late = (policy.act_at(OBSERVATIONS, np.full(ROWS, t), np.full(ROWS, 1000.0)) for t in (0.0, 999.0))
    assert np.abs(early - late).max() > 0.1


@pytest.mark.parametrize("normalize_embedding", [False, True])
def test_inputs_agree_with_what_the_learner_feeds_its_networks(normalize_embedding):
    import jax
    import jax.numpy as jnp

    from perdure.learn import PPOConfig
    from perdure.learn.networks import RunningMoments
    from perdure.learn.rollout import network_inputs

    policy = random_policy(normalize_embedding=normalize_embedding)
    horizons = np.full(ROWS, 700.0)
    with jax.enable_x64(True):
        moments = RunningMoments(jnp.asarray(policy.normalizer.mean), jnp.asarray(policy.normalizer.var), jnp.ones(()))
        arrays = (jnp.asarray(x) for x in (OBSERVATIONS, ELAPSED, horizons))
        learners = network_inputs(PPOConfig(protocol=policy.protocol), moments, *arrays)
    ours = policy.inputs(OBSERVATIONS, policy.embed(ELAPSED, horizons))
    np.testing.assert_allclose(ours, np.asarray(learners), rtol=0, atol=1e-6)


def test_actions_stay_inside_a_lopsided_box():
    task = TaskInfo("custom", 11, (-0.1, -3.0, 0.0), (0.2, -2.5, 0.01))
    actions = random_policy(task=task).act(OBSERVATIONS, ELAPSED)
    assert np.all(actions >= task.action_low)
    assert np.all(actions <= task.action_high)


class TestClocks:
    def test_the_policys_own_clock_is_used_unless_another_is_given(self):
        policy = random_policy(clock=Constant(300.0))
        own = policy.act(OBSERVATIONS, ELAPSED)
        np.testing.assert_array_equal(own, policy.act(OBSERVATIONS, ELAPSED, Constant(300.0)))
        assert not np.array_equal(own, policy.act(OBSERVATIONS, ELAPSED, Constant(0.0)))

    def test_a_constant_clock_makes_elapsed_steps_meaningless(self):
        policy = random_policy()
        np.testing.assert_array_equal(policy.act(OBSERVATIONS, ELAPSED), policy.act(OBSERVATIONS, 0 * ELAPSED))

    def test_a_policy_without_phi_takes_no_clock(self):
        with pytest.raises(PerdureError, match="no clock"):
            random_policy(embedding=None).act(OBSERVATIONS, ELAPSED, Constant(1.0))


@pytest.mark.parametrize("shape", [(11,), (4, 10), (4, 11, 1)])
def test_observations_of_another_shape_are_refused(shape):
    with pytest.raises(PerdureError, match=r"\(n, 11\)"):
        random_policy().act(np.zeros(shape), np.zeros(4))


@pytest.mark.parametrize("embedding", ["geometric", None])
def test_elapsed_steps_of_another_length_are_refused(embedding):
    with pytest.raises(PerdureError, match="elapsed"):
        random_policy(embedding=embedding).act(np.zeros((4, 11)), np.zeros(3))


def test_a_policy_cannot_be_changed():
    with pytest.raises(dataclasses.FrozenInstanceError):
        random_policy().activation = "relu"
