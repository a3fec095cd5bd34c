"""The recipe of the cure: what it changes, and that a stranger's policy begins as it was."""

import shlex
from dataclasses import replace

import jax
import numpy as np
import pytest

from perdure.envs import task_spec
from perdure.errors import PerdureError
from perdure.horizon import Fixed, Geometric, HorizonProtocol
from perdure.learn.networks import ACTIVATIONS, forward, merge
from perdure.learn.provenance import command
from perdure.learn.recipe import Recipe
from perdure.learn.run import Segments
from perdure.policy import Normalizer, Reference, TaskInfo, save_policy
from perdure.policy.files import find_policy
from perdure.policy.network import ACTIVATIONS as ACTED
from perdure.policy.policy import SEEN, TanhSquash
from studies.cure.grid import ARMS
from tests.policy.make_policy import random_policy

TASK = "InvertedPendulum-v4"
PENDULUM = TaskInfo(TASK, 4, (-3.0,), (3.0,))


def plain(**parts):
    """A policy without a time-to-go input, trained with a horizon of 100 steps."""
    protocol = HorizonProtocol(None, Fixed(1000), "truncated", 0.99, 0.99)
    return random_policy(task=PENDULUM, embedding=None, **({"protocol": protocol} | parts))


def begun(policy):
    """The learner's state before its first step."""
    segments = Segments(TASK, Recipe().config(policy, TASK), 1)
    state = segments.first(0, policy).learner
    return segments.algorithm.policy(state), state


@pytest.mark.parametrize("task", ["Hopper-v3", "Walker2d-v3", "HalfCheetah-v3"])
def test_on_the_robots_of_the_study_it_is_the_registered_training(task):
    registered = next(arm for arm in ARMS if arm.name == "continued-long-noise").run(task)
    run = Recipe().run(registered.start, task, seeds=registered.seeds, name=registered.method)
    assert [run.identity(seed) for seed in run.seeds] == [registered.identity(seed) for seed in run.seeds]
    assert run.key(13) == registered.key(13)


@pytest.mark.parametrize(("own", "gamma"), [(0.99, 0.999), (0.9999, 0.9999), (1.0, 0.999)])
def test_a_horizon_is_lengthened_and_never_shortened(own, gamma):
    protocol = HorizonProtocol(None, Fixed(1000), "truncated", own, 0.99)
    assert Recipe().config(plain(protocol=protocol), TASK).protocol.gamma == gamma


def test_any_other_task_has_a_falling_step_size_and_noise_in_units_of_its_actions():
    config = Recipe().config(plain(), TASK)
    assert config.learning_rate_decay == "linear"
    assert config.log_std_init == pytest.approx(-1.0 + np.log(3.0)), "actions go from -3 to 3"
    assert config.hidden_sizes == (8, 8)
    assert config.total_steps == 300_000


def test_a_time_to_go_keeps_the_protocol_that_it_was_trained_with():
    policy = random_policy(task=PENDULUM)
    config = Recipe().config(policy, TASK)
    assert config.protocol == policy.protocol
    assert config.protocol.embedding == Geometric(5)
    film = Recipe().config(random_policy(task=PENDULUM, film=True), TASK)
    assert film.conditioning == "film"


def test_a_policy_of_raw_observations_acts_as_before_and_keeps_its_scale():
    low = np.array([-2.0, -40.0, 0.0, 3.0])
    high = np.array([2.0, 60.0, 1.0, 3.0])  # the last one never changed
    reference = Reference(10, np.ones((1, 1)), np.array([10]), np.array([False]), low, high)
    policy = plain(normalizer=Normalizer.identity(4), reference=reference)
    acting, state = begun(policy)
    steps = np.zeros(50)
    wide = np.random.default_rng(0).uniform(2.0 * low - high, 2.0 * high - low, (50, 4))
    np.testing.assert_allclose(acting.act(wide, steps), policy.act(wide, steps), rtol=1e-4, atol=1e-5)
    with jax.enable_x64(True):
        seen = merge(state.statistics.observations, wide)
    np.testing.assert_allclose(seen.mean, state.statistics.observations.mean, atol=1e-9)


def test_statistics_of_another_library_keep_the_count_that_they_were_saved_with():
    _, state = begun(plain(provenance={"method": "SB3 PPO (model)", "steps": 5_000, SEEN: 5_001.0}))
    assert float(state.statistics.observations.count) == 5_001.0
    _, state = begun(plain(provenance={"method": "SB3 PPO (model)", "steps": 5_000}))
    assert float(state.statistics.observations.count) == 5_000.0


@pytest.mark.parametrize("name", ACTED)
def test_training_and_deployment_know_the_same_activations(name):
    policy = plain(activation=name)
    inputs = np.random.default_rng(0).normal(size=(20, 4)).astype(np.float32)
    trained = forward(policy.weights, "policy", inputs, name)
    np.testing.assert_allclose(trained, policy._actor(inputs), rtol=1e-5, atol=1e-6)
    assert set(ACTED) == set(ACTIVATIONS)


def test_what_it_cannot_continue_it_says_with_a_way_out(tmp_path):
    linear = plain(hidden=())
    discrete = replace(PENDULUM, action_low=(0.0,), action_high=(1.0,), discrete_actions=True)
    choices = random_policy(task=discrete, embedding=None, weights=two_choices())
    for policy, word in ((plain(squash=TanhSquash()), "tanh"), (linear, "hidden"), (choices, "discrete")):
        file = save_policy(policy, tmp_path / f"{word}.safetensors")
        with pytest.raises(PerdureError, match=rf"{word}.*own learner"):
            Recipe().run(file, TASK)


def two_choices():
    """Weights of a network with an output for each of two choices."""
    two = TaskInfo(TASK, 4, (-1.0, -1.0), (1.0, 1.0))
    return random_policy(task=two, embedding=None).weights


def test_what_continues_a_shipped_policy_names_it_and_no_place_on_this_machine():
    run = Recipe().run(find_policy("Hopper-v3/ppo"), "Hopper-v3")
    words = shlex.split(command(run, task_spec("Hopper-v3"), 0))
    assert words[words.index("--from") + 1] == "Hopper-v3/ppo"
