"""Presets: whose hyperparameters a method begins with."""

import pytest

from perdure.errors import PerdureError
from perdure.horizon import Fixed, Uniform
from perdure.learn import TrainRun, method_config


def test_cleanrl_is_the_defaults_of_sb3_with_a_falling_step_size_on_every_task():
    for task in ("Hopper-v3", "gymnasium:Walker2d-v5", "Pendulum-v1"):
        config = method_config("ppo", task, 11, "cleanrl")
        assert (config.n_envs, config.n_steps, config.batch_size, config.n_epochs) == (1, 2048, 64, 10)
        assert (config.learning_rate, config.learning_rate_decay, config.clip_range) == (3e-4, "linear", 0.2)
        assert (config.protocol.gamma, config.gae_lambda, config.ent_coef) == (0.99, 0.95, 0.0)
        assert (config.hidden_sizes, config.activation, config.log_std_init) == ((64, 64), "tanh", 0.0)


def test_an_undiscounted_method_keeps_the_gamma_of_the_reward_normalizer():
    protocol = method_config("geometric", "Hopper-v3", 11, "cleanrl").protocol
    assert (protocol.gamma, protocol.normalizer_gamma) == (1.0, 0.99)


def test_a_near_name_is_offered():
    with pytest.raises(PerdureError, match="did you mean 'cleanrl'"):
        method_config("ppo", "Hopper-v3", 11, "cleanlr")


def test_a_run_with_the_zoo_s_preset_is_the_run_it_was_before_there_were_presets():
    config = method_config("ppo", "Hopper-v3", 11, "zoo")
    run = TrainRun("Hopper-v3", "ppo", config, preset="zoo")
    assert run.key(3) == "Hopper-v3/ppo/seed-3"
    assert run.identity(3) == {"task": "Hopper-v3", "method": "ppo", "seed": 3, "config": config.to_json()}
    other = TrainRun("Hopper-v3", "ppo", config, preset="cleanrl")
    assert other.key(3) == "Hopper-v3/ppo@cleanrl/seed-3"
    assert other.identity(3)["preset"] == "cleanrl"


@pytest.mark.parametrize(
    ("task", "usual"), [("Hopper-v3", "cleanrl"), ("gymnasium:Walker2d-v5", "cleanrl"), ("Ant-v3", "zoo")]
)
def test_a_task_has_a_usual_preset_that_works(task, usual):
    assert method_config("ppo", task, 11) == method_config("ppo", task, 11, usual)
    assert TrainRun(task, "ppo", method_config("ppo", task, 11)).preset == usual


def test_the_horizons_of_the_methods_scale_with_the_step_limit_of_the_environment():
    for limit, low, high in ((1000, 200, 1000), (50, 10, 50), (1, 1, 1)):
        assert method_config("geometric", "Mine-v0", 3, limit=limit).protocol.horizon == Uniform(low, high)
        assert method_config("ppo", "Mine-v0", 3, limit=limit).protocol.horizon == Fixed(high)
