"""The callback of Stable-Baselines3, with a stand-in of that library and, under `make verify`, with itself."""

from __future__ import annotations

import importlib
import sys
from types import ModuleType, SimpleNamespace

import numpy as np
import polars as pl
import pytest
from gymnasium.spaces import Box, Dict
from probes import Falling, Walkway

from perdure.errors import PerdureError


class BaseCallback:
    """What Stable-Baselines3's class does with a callback, as far as ours needs it."""

    def __init__(self, verbose=0):
        self.num_timesteps, self.verbose = 0, verbose

    @property
    def logger(self):
        return self.model.logger

    def init_callback(self, model):
        self.model = model

    def on_step(self):
        self.num_timesteps = self.model.num_timesteps
        return self._on_step()


class Logger:
    def __init__(self):
        self.recorded, self.dumped = {}, []

    def record(self, name, value, exclude=None):
        self.recorded[name] = value

    def dump(self, step):
        self.dumped.append((step, self.recorded))
        self.recorded = {}


class Model:
    """Acts with the observation's first number; counts how often it was asked, and whether deterministically."""

    def __init__(self, normalizer=None):
        self.num_timesteps, self.logger, self.policy = 0, Logger(), SimpleNamespace()
        self.normalizer, self.seen = normalizer, []
        self.observation_space = Falling.observation_space

    def get_vec_normalize_env(self):
        return self.normalizer

    def predict(self, observations, state=None, starts=None, deterministic=False):
        assert deterministic
        self.seen.append(observations)
        return np.clip(observations[:, :1], -1, 1), None


@pytest.fixture
def module(monkeypatch):
    """The module of the callback, imported beside the stand-in."""
    callbacks = ModuleType("stable_baselines3.common.callbacks")
    callbacks.BaseCallback = BaseCallback
    for name in ("stable_baselines3", "stable_baselines3.common"):
        monkeypatch.setitem(sys.modules, name, ModuleType(name))
    monkeypatch.setitem(sys.modules, callbacks.__name__, callbacks)
    monkeypatch.delitem(sys.modules, "perdure.evaluate.callback", raising=False)
    yield importlib.import_module("perdure.evaluate.callback")
    sys.modules.pop("perdure.evaluate.callback")


def learn(callback, model, steps, each=50):
    """Train for some steps, as far as a callback sees."""
    callback.init_callback(model)
    callback._on_training_start()
    for _ in range(steps // each):
        model.num_timesteps += each
        assert callback.on_step()
    callback._on_training_end()


def test_it_logs_at_the_start_every_so_many_steps_and_at_the_end(module):
    model = Model()
    callback = module.VerdictCallback(Falling, every_steps=100, steps=100, eval_seeds=3, training_horizon=50)
    learn(callback, model, 250)
    assert [step for step, _ in model.logger.dumped] == [0, 100, 200, 250]
    _, logged = model.logger.dumped[-1]
    final = callback.result.final.filter(disturbance="none")
    assert logged["perdure/mean_return_calm"] == pytest.approx(final["return"].mean())
    assert len(final) == 3
    assert "perdure/holds_standard-1" in logged
    assert logged["perdure/holds_calm"] == 0.0  # the world ends every episode by step 60
    assert 5 <= logged["perdure/median_failure_step_calm"] <= 60


@pytest.mark.verify
def test_the_model_is_saved_when_it_is_better_than_the_saved_one(module, tmp_path):
    class Learning(Model):
        """Walks at a speed that each 100 steps of training change, and saves its speed."""

        def __init__(self):
            super().__init__()
            self.observation_space = Walkway.observation_space

        @property
        def speed(self):
            return {0: 0.4, 100: 0.8, 200: 0.3}[self.num_timesteps // 100 * 100]

        def predict(self, observations, state=None, starts=None, deterministic=False):
            return np.full((len(observations), 1), self.speed), None

        def save(self, path):
            path.write_text(str(self.speed))

    model = Learning()
    options = {"steps": 100, "eval_seeds": 20, "training_horizon": 100, "disturb": "none"}
    best = tmp_path / "best" / "model.zip"
    callback = module.VerdictCallback(Walkway, every_steps=100, best=best, **options)
    learn(callback, model, 50)
    assert best.read_text() == "0.4", "the first one"
    learn(callback, model, 100)
    assert best.read_text() == "0.8"
    model.num_timesteps = 200
    callback.on_step()
    assert callback.result is not callback.best_result
    assert best.read_text() == "0.8", "a slower one does not replace it"


def test_the_policy_sees_normalized_observations(module):
    shown = SimpleNamespace(normalize_obs=lambda observations: observations + 7.0)
    model = Model(shown)
    learn(module.VerdictCallback(Falling, steps=20, eval_seeds=1, disturb=["none"]), model, 50)
    assert min(float(each.min()) for each in model.seen) >= 7.0


def test_the_numbers_that_training_draws_stay_the_same(module):
    """Stable-Baselines3 shuffles its minibatches by NumPy's global generator."""

    class Drawing(Falling):
        def reset(self, **options):
            np.random.random()
            return super().reset(**options)

    np.random.seed(3)
    drawn = np.random.random(2)
    np.random.seed(3)
    first = np.random.random()
    learn(module.VerdictCallback(Drawing, steps=20, eval_seeds=2, disturb="none"), Model(), 50)
    assert [first, np.random.random()] == drawn.tolist()


def test_an_environment_without_the_wrappers_of_training_is_refused(module):
    model = Model()
    model.observation_space = Dict(observation=Falling.observation_space, time_to_go=Box(0, 1, (5,)))
    with pytest.raises(PerdureError, match=r"'time_to_go': \[5\]}, env gives {'array': \[2\]}: pass a function"):
        learn(module.VerdictCallback(Falling, steps=20, eval_seeds=1), model, 50)


def test_each_disturbed_evaluation_is_logged_under_its_name(module):
    model = Model()
    learn(module.VerdictCallback(Falling, steps=20, eval_seeds=1, disturb="action_noise:0.1,0.2"), model, 50)
    assert {"perdure/holds_action_noise:0.1", "perdure/holds_action_noise:0.2"} < model.logger.dumped[0][1].keys()


@pytest.mark.parametrize("option", ["clocks", "hours", "out", "recurrent"])
def test_options_of_a_single_evaluation_are_refused_before_training(module, option):
    with pytest.raises(PerdureError, match=f"takes no {option}"):
        module.VerdictCallback("Pendulum-v1", **{option: 1})


def test_without_the_library_the_message_names_it(monkeypatch):
    from perdure.evaluate import callback

    monkeypatch.setattr(callback, "BaseCallback", object)
    with pytest.raises(PerdureError, match="pip install stable-baselines3"):
        callback.VerdictCallback("Pendulum-v1")


@pytest.mark.verify
def test_ppo_of_stable_baselines3_logs_its_verdict(tmp_path):
    """Two environments of 256 steps an iteration: 4,096 steps are eight iterations."""
    pytest.importorskip("stable_baselines3")
    from stable_baselines3 import PPO
    from stable_baselines3.common.env_util import make_vec_env
    from stable_baselines3.common.logger import configure
    from stable_baselines3.common.vec_env import VecNormalize

    import perdure

    model = PPO("MlpPolicy", VecNormalize(make_vec_env("Pendulum-v1", 2)), n_steps=256, seed=0, device="cpu")
    model.set_logger(configure(str(tmp_path), ["csv"]))
    options = {"steps": 300, "eval_seeds": 2, "disturb": "action_noise:0.1"}
    callback = perdure.VerdictCallback("Pendulum-v1", every_steps=2000, **options)
    model.learn(4096, callback=callback)
    rows, final = pl.read_csv(tmp_path / "progress.csv"), callback.result.final
    assert rows["time/total_timesteps"].drop_nulls().to_list() == list(range(512, 4097, 512))
    assert rows["train/loss"].is_not_null().any(), "what the library logs itself is still there"
    logged = rows.filter(pl.col("perdure/holds_action_noise:0.1").is_not_null())
    assert len(logged) == 4, "before the first step, after 2,000 and 4,000, and at the end"
    assert logged["perdure/holds_action_noise:0.1"][-1] == (final["outcome"] == "holds").mean()
    assert logged["perdure/mean_return_action_noise:0.1"][-1] == pytest.approx(final["return"].mean())
    assert final["end_step"].to_list() == [300, 300]


class Remembering(Model):
    """A recurrent policy, whose state counts its calls."""

    def __init__(self):
        super().__init__()
        self.policy.lstm_actor = self.counts = []

    def predict(self, observations, state=None, starts=None, deterministic=False):
        self.counts.append(state)
        return np.clip(observations[:, :1], -1, 1), (state or 0) + 1


def test_a_recurrent_policy_keeps_its_memory(module):
    model = Remembering()
    learn(module.VerdictCallback(Falling, steps=20, eval_seeds=1, disturb=["none"]), model, 50)
    assert model.counts[:3] == [None, 1, 2]
