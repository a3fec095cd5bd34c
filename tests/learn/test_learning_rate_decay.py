"""The linear schedule of the step size against its closed form, lr * (1 - (i + 1) / n) as in Stable-Baselines3."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from perdure.errors import PerdureError
from perdure.horizon import Fixed, HorizonProtocol
from perdure.learn import PPOConfig
from perdure.learn.networks import init_params
from perdure.learn.ppo import Batch, epoch, start_adam

CONFIG = PPOConfig(
    protocol=HorizonProtocol(None, Fixed(10), "truncated", gamma=0.9, normalizer_gamma=0.9),
    n_envs=1,
    n_steps=32,
    batch_size=8,
    n_epochs=2,
    hidden_sizes=(8,),
    total_steps=4 * 32,
    learning_rate=1e-2,
    learning_rate_decay="linear",
    log_std_init=-1.0,
)
CONSTANT = replace(CONFIG, learning_rate_decay="none")


compiled = jax.jit(epoch, static_argnames="config")
"""As in training: once for each configuration."""


def one_minibatch(config, iteration):
    keys = jax.random.split(jax.random.key(0), 5)
    params = init_params(keys[0], 3, 2, config)
    batch = Batch(
        jax.random.normal(keys[1], (32, 3)),
        jax.random.normal(keys[2], (32, 2)),
        -jnp.ones(32),
        jax.random.normal(keys[3], (32,)),
        jax.random.normal(keys[4], (32,)),
    )
    adam = start_adam(params)
    adam = adam._replace(count=adam.count + iteration * 2 * 4)  # two epochs of four minibatches in an iteration
    return params, compiled(params, adam, batch, jnp.arange(config.batch_size), config=config)[0]


@pytest.mark.parametrize(("iteration", "share"), [(0, 0.75), (2, 0.25)])
def test_an_iteration_learns_with_its_share_of_the_step_size(iteration, share):
    before, decayed = one_minibatch(CONFIG, iteration)
    _, undecayed = one_minibatch(CONSTANT, iteration)
    for name, value in before.items():
        moved = undecayed[name] - value
        np.testing.assert_allclose(decayed[name] - value, share * moved, rtol=0, atol=1e-6)
    assert np.abs(moved).max() > 1e-3


def test_the_last_iteration_learns_nothing_as_in_sb3():
    before, after = one_minibatch(CONFIG, 3)
    for name, value in before.items():
        np.testing.assert_array_equal(value, after[name])


def test_settings_of_older_runs_mean_what_they_meant():
    assert "learning_rate_decay" not in CONSTANT.to_json()
    assert CONFIG.to_json()["learning_rate_decay"] == "linear"


def test_another_word_is_refused():
    with pytest.raises(PerdureError, match=r"learning_rate_decay is 'cosine'.*'none' or 'linear'"):
        replace(CONFIG, learning_rate_decay="cosine")


@pytest.mark.parametrize(("iteration", "ceiling"), [(0, -1.0), (1, -1.0 - 2.0 / 2.4), (2, -1.0 - 4.0 / 2.4), (3, -3.0)])
def test_the_noise_stays_below_a_line(iteration, ceiling):
    """It falls from -1 to -3 in 60 % of four iterations; log_std would move by at most 0.01 in an Adam step."""
    _, capped = one_minibatch(replace(CONSTANT, log_std_end=-3.0), iteration)
    _, unbound = one_minibatch(CONSTANT, iteration)
    np.testing.assert_allclose(capped["log_std"], np.minimum(unbound["log_std"], ceiling), rtol=1e-6)
    assert (np.asarray(unbound["log_std"]) > -1.05).all()
    np.testing.assert_array_equal(capped["policy.0.weight"], unbound["policy.0.weight"])


def test_a_ceiling_above_the_start_is_refused():
    with pytest.raises(PerdureError, match=r"log_std_fall is \(0.5, 0.5\)"):
        replace(CONFIG, log_std_fall=(0.5, 0.5))
    late = replace(CONFIG, log_std_end=-1.0, log_std_fall=(0.5, 0.9))
    assert late.to_json()["log_std_fall"] == [0.5, 0.9]
    with pytest.raises(PerdureError, match=r"log_std_end is 1.*at most log_std_init = -1"):
        replace(CONFIG, log_std_end=1.0)
    assert "log_std_end" not in CONFIG.to_json()


def test_a_run_of_one_iteration_which_would_learn_nothing_is_refused():
    with pytest.raises(PerdureError, match=r"total_steps is 32.*more than one rollout of 32 steps"):
        replace(CONFIG, total_steps=32)
    replace(CONFIG, total_steps=32, learning_rate_decay="none")
    replace(CONFIG, total_steps=33)
