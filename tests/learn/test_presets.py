"""Presets: whose hyperparameters a method begins with."""

import gc
from dataclasses import dataclass, replace
from types import SimpleNamespace

import pytest

from perdure.errors import PerdureError
from perdure.evaluate.table import method_label
from perdure.horizon import Fixed, Uniform
from perdure.learn import PPOConfig, TrainRun, method_config


def test_cleanrl_is_the_defaults_of_sb3_with_a_falling_step_size_on_every_task():
    for task in ("Hopper-v3", "gymnasium:Walker2d-v5", "Pendulum-v1"):
        config = method_config("ppo", task, 11, "cleanrl")
        assert (config.n_envs, config.n_steps, config.batch_size, config.n_epochs) == (1, 2048, 64, 10)
        assert (config.learning_rate, config.learning_rate_decay, config.clip_range) == (3e-4, "linear", 0.2)
        assert (config.protocol.gamma, config.gae_lambda, config.ent_coef) == (0.99, 0.95, 0.0)
        assert (config.hidden_sizes, config.activation, config.log_std_init) == ((64, 64), "tanh", 0.0)


def test_ant_starts_with_less_noise_and_other_tasks_of_the_zoo_s_defaults_do_not():
    ant = method_config("geometric", "gymnasium:Ant-v5", 105)
    assert ant == replace(method_config("geometric", "Pusher-v4", 105), log_std_init=-1.0)
    assert method_config("geometric", "Ant-v3", 111, "cleanrl").log_std_init == 0.0


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


@pytest.fixture
def forget():
    """Leave no algorithm of a test to the next one."""
    yield
    gc.collect()


@pytest.mark.usefixtures("forget")
@pytest.mark.parametrize(
    ("presets", "usual", "folder"), [((), None, "other"), (("slow", "fast"), "slow", "other@slow")]
)
def test_the_presets_of_another_algorithm_are_its_own(monkeypatch, presets, usual, folder):
    other = dataclass(frozen=True)(
        type("Other", (PPOConfig,), {"name": "other", "presets": presets, "__module__": __name__})
    )
    monkeypatch.setattr(other, "usual_preset", classmethod(lambda cls, task: usual))
    run = TrainRun("Hopper-v3", "other", other())
    assert (run.preset, run.key(0)) == (usual, f"Hopper-v3/{folder}/seed-0")
    assert run.identity(0).get("preset") == usual


@pytest.mark.parametrize(
    ("provenance", "label"),
    [
        ({"method": "ppo", "config": {"n_steps": 1}}, "ppo (zoo)"),
        ({"method": "ppo", "config": {"n_steps": 1}, "preset": "cleanrl"}, "ppo"),
        ({"method": "es", "config": {"algorithm": "es"}}, "es"),
        ({"method": "es", "config": {"algorithm": "es"}, "preset": "slow"}, "es (slow)"),
        ({"method": "SAC"}, "SAC"),
    ],
)
def test_a_table_names_a_preset_that_is_not_the_usual_one(provenance, label):
    policy = SimpleNamespace(provenance=provenance, task=SimpleNamespace(name="Hopper-v3"))
    assert method_label(policy, "unknown") == label
