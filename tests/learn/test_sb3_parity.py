"""One iteration of Stable-Baselines3's PPO, recorded, against ours: the same rollout, the same minibatch order.

The recording is made by ``benchmarks/peers/sb3_record.py`` with stable-baselines3 2.9 and torch 2.13. It has 12 episode
ends in it, falls and time limits, so the bootstrap of the last observation is part of what is compared.
"""

from __future__ import annotations

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from safetensors.numpy import load_file

from perdure.envs import TaskSpec
from perdure.envs.traced import TracedStep, TracedWorld
from perdure.horizon import Fixed, HorizonProtocol
from perdure.learn import PPOConfig
from perdure.learn.networks import start_moments
from perdure.learn.ppo import epoch, prepare, start_adam
from perdure.learn.rollout import Statistics, draw, finish, make_collect, start_env_state, update_moments

RECORDING = Path(__file__).parent / "data" / "sb3_iteration.safetensors"
N_STEPS, N_ENVS = 128, 2


def config(end="truncated"):
    return PPOConfig(
        protocol=HorizonProtocol(None, Fixed(25), end, gamma=0.99, normalizer_gamma=0.98),
        n_envs=N_ENVS,
        n_steps=N_STEPS,
        batch_size=64,
        n_epochs=3,
        gae_lambda=0.95,
        learning_rate=1e-3,
        ent_coef=0.01,
        clip_range=0.1,
        max_grad_norm=0.5,
        vf_coef=0.7,
        hidden_sizes=(32, 32),
        activation="tanh",
        log_std_init=-0.5,
        total_steps=256,
    )


@pytest.fixture(scope="module")
def recording():
    return load_file(RECORDING)


def params_of(recording, when):
    names = [key for key in recording if key.startswith(f"{when}/")]
    return {key.split("/")[1]: jnp.asarray(recording[key]) for key in names}


def replay(recording):
    """A world that plays the recording back, whatever the actions are. Its handle is the number of the step."""
    after, last = jnp.asarray(recording["raw/observations"][1:]), jnp.asarray(recording["raw/last"])
    rewards = jnp.asarray(recording["raw/rewards"], jnp.float64)
    terminated = jnp.asarray((recording["raw/dones"] > 0) & (recording["raw/truncated"] == 0))
    shown = {}

    def step(number, actions):
        i = number.astype(int)
        # A reset shows the first observation of the new episode: the one that follows in the recording.
        shown["next"] = after[i]
        return number + 1, TracedStep(last[i], rewards[i], terminated[i], jnp.zeros(N_ENVS, bool))

    return TracedWorld(step, lambda done: shown["next"])


def collected(recording, settings):
    """Our rollout over the recorded world, and the statistics of our normalizer after it."""
    with jax.enable_x64(True):
        world = replay(recording)
        spec = TaskSpec("Hopper-v3", "recorded", "none", 11, -np.ones(3), np.ones(3), 1000)
        env_state = start_env_state(settings, jnp.asarray(recording["raw/observations"][0]), jnp.zeros(N_ENVS))
        statistics = Statistics(update_moments(settings, start_moments(11), env_state), start_moments(1))
        collect = jax.jit(make_collect(world, spec, settings))
        draws = draw(jax.random.key(0), 3, config=settings)
        params = params_of(recording, "before")
        _, last, trace = collect(jnp.zeros(()), (env_state, statistics), params, draws)
        return finish(last, trace, config=settings)


def env_major(array):
    """SB3 flattens its buffer environment by environment."""
    return np.asarray(array).swapaxes(0, 1).reshape(N_STEPS * N_ENVS, -1)


def with_recorded_actions(recording, experience):
    actions = recording["buffer/actions"].reshape(N_ENVS, N_STEPS, -1).swapaxes(0, 1)
    return experience._replace(actions=jnp.asarray(actions))


def our_order(order):
    """Row env * n_steps + step of SB3 is row step * n_envs + env of ours."""
    env, step = np.divmod(order, N_STEPS)
    return jnp.asarray(step * N_ENVS + env)


compiled = jax.jit(epoch, static_argnames="config")


def learned(recording, settings, result):
    experience = with_recorded_actions(recording, result.experience)
    ready = prepare(params_of(recording, "before"), (), experience, 0, 1, config=settings)
    params = params_of(recording, "before")
    adam = start_adam(params)
    for order in recording["orders"]:
        params, adam, _ = compiled(params, adam, ready.batch, our_order(order), config=settings)
    return ready, params


@pytest.fixture(scope="module")
def ours(recording):
    """Our rollout over the recording, what was learned from, and the weights after it: computed once."""
    result = collected(recording, config())
    return result, *learned(recording, config(), result)


def test_the_recording_holds_falls_and_time_limits(recording):
    assert recording["raw/truncated"].sum() >= 2
    assert recording["raw/dones"].sum() - recording["raw/truncated"].sum() >= 2


def test_normalized_observations_and_statistics_equal_sb3s(recording, ours):
    result, _, _ = ours
    np.testing.assert_allclose(
        env_major(result.experience.inputs[:-1]), recording["buffer/observations"], rtol=0, atol=1e-6
    )
    for moments, name in zip(result.statistics, ("observation", "return"), strict=True):
        for part in ("mean", "var", "count"):
            np.testing.assert_allclose(np.asarray(getattr(moments, part)), recording[f"{name}.{part}"].squeeze(), 1e-6)


def test_episode_ends_equal_sb3s(recording, ours):
    ends = ours[0].experience.ends
    np.testing.assert_array_equal(np.asarray(ends.done), recording["raw/dones"] > 0)
    np.testing.assert_array_equal(np.asarray(ends.horizon_end & ~ends.terminated), recording["raw/truncated"] > 0)


@pytest.mark.parametrize("name", ["log_probs", "advantages", "returns"])
def test_what_is_learned_from_equals_sb3s(recording, ours, name):
    _, ready, _ = ours
    found = np.asarray(getattr(ready.batch, name)).reshape(N_STEPS, N_ENVS)
    np.testing.assert_allclose(env_major(found), recording[f"buffer/{name}"], rtol=0, atol=1e-5)


def test_weights_after_one_iteration_equal_sb3s(recording, ours):
    _, _, params = ours
    expected = params_of(recording, "after")
    moved = max(float(jnp.abs(expected[k] - v).max()) for k, v in params_of(recording, "before").items())
    assert moved > 5e-3, "the recorded update hardly moved the weights: this test would prove little"
    for name, value in params.items():
        np.testing.assert_allclose(np.asarray(value), np.asarray(expected[name]), rtol=0, atol=1e-5, err_msg=name)


def test_treating_the_limit_as_a_true_end_misses_sb3s_weights(recording):
    """Negative control: without the bootstrap of the last observation the comparison above fails by far."""
    settings = config(end="terminated")
    _, params = learned(recording, settings, collected(recording, settings))
    expected = params_of(recording, "after")
    assert max(float(jnp.abs(expected[k] - v).max()) for k, v in params.items()) > 1e-4
