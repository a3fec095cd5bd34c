"""What an imported policy knows beside its network, and importing into a folder."""

from __future__ import annotations

import warnings

import gymnasium
import numpy as np
import pytest
from altered import FIXTURES, model, rebuilt, with_settings
from gymnasium.envs.classic_control import PendulumEnv

from perdure.envs import task_spec
from perdure.errors import PerdureError, PerdureWarning
from perdure.horizon import Countdown, Fixed, TimeFeature
from perdure.policy import Policy, load_policy
from perdure.policy.readers import import_once
from perdure.policy.readers.sb3 import is_sb3_zip, read_sb3
from perdure.policy.readers.sb3_import import trained_on
from perdure.policy.readers.trusted import load_sb3

ALGORITHMS = {
    **{"ppo": "PPO", "ppo-sde": "PPO", "ppo-time": "PPO", "a2c": "A2C", "trpo": "TRPO"},
    **{"ars": "ARS", "ars-mlp": "ARS"},
    **{"sac": "SAC", "sac-sde": "SAC", "sac-time": "SAC", "td3": "TD3", "ddpg": "TD3", "tqc": "TQC"},
}


def imported(name, env="Pendulum-v1", **options):
    options.setdefault("normalizer", "none")
    options.setdefault("measure", False)
    return Policy.from_sb3(FIXTURES / f"{name}.zip", env, **options)


def test_every_model_among_the_fixtures_is_named():
    others = {"dqn", "qrdqn", "ppo-discrete", "a2c-multidiscrete", "ppo-onehot", "sac-dict"}
    assert {path.stem for path in FIXTURES.glob("*.zip")} == {*ALGORITHMS, *others}


@pytest.mark.parametrize("name", ALGORITHMS)
def test_the_algorithm_and_the_source_are_noted(name):
    timed = "linear" if name.endswith("-time") else None
    provenance = imported(name, time_feature=timed).provenance
    assert provenance["method"] == f"SB3 {ALGORITHMS[name]} ({name})"
    assert (provenance["seed"], provenance["steps"]) == (0, 800 if name.startswith("ars") else 128)
    assert provenance["source"]["stable-baselines3"] == "2.9.2"


@pytest.mark.parametrize(
    ("info", "engine"),
    [
        ("Gym: 0.19.0\n", "Gym 0.19.0, MuJoCo 2.1 or older (mujoco-py)"),
        ("- Gymnasium: 1.1.1\n- OpenAI Gym: 0.26.2\n", "Gymnasium 1.1.1, MuJoCo of unknown version"),
        ("- Numpy: 2.0\n", None),
    ],
)
def test_the_engine_of_training_is_noted_where_the_zip_names_it(tmp_path, info, engine):
    """Gym before 0.24 had only mujoco-py, which ends with MuJoCo 2.1; no zip names MuJoCo itself."""
    path = tmp_path / "model.zip"
    path.write_bytes(rebuilt(model("trpo"), {"system_info.txt": info.encode()}))
    gym = read_sb3(path).gym
    assert (trained_on(gym, task_spec("gymnasium:InvertedPendulum-v5")) or None) == engine
    assert trained_on(gym, task_spec("gymnasium:Pendulum-v1")) == "", "no engine but Gymnasium's own"


def test_a_missing_normalizer_is_named_with_its_flag(tmp_path):
    with pytest.raises(PerdureError, match=r"normalizer.*gone\.pkl"):
        imported("ppo", normalizer=tmp_path / "gone.pkl")
    with pytest.raises(PerdureError, match="--normalizer"):
        import_once(FIXTURES / "ppo.zip", tmp_path, "Pendulum-v1", normalizer=str(tmp_path / "gone.pkl"))


def test_how_time_is_treated():
    plain = imported("ppo", normalizer=FIXTURES / "ppo.pkl")
    assert (plain.protocol.embedding, plain.clock, plain.protocol.horizon) == (None, None, Fixed(200))
    assert (plain.protocol.end, plain.protocol.gamma) == ("truncated", 0.99)
    timed = imported("ppo-time", normalizer=FIXTURES / "ppo-time.pkl", time_feature="linear")
    assert (timed.protocol.embedding, timed.clock) == (TimeFeature(200), Countdown(200.0))
    assert timed.protocol.normalize_embedding  # VecNormalize is outside the wrapper
    assert not imported("sac-time", time_feature="linear").protocol.normalize_embedding


def test_a_time_feature_with_other_steps_than_the_environment_gives_a_warning_and_its_horizon():
    with pytest.warns(PerdureWarning, match=r"50.*200"):
        policy = imported("sac-time", time_feature="linear:50")
    assert policy.protocol.horizon == Fixed(50)


def test_a_training_horizon_of_the_user_s_own_replaces_the_step_limit():
    policy = imported("trpo", training_horizon=50, measure=True)
    assert (policy.protocol.horizon, policy.reference.horizon) == (Fixed(50), 50)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        timed = imported("sac-time", time_feature="linear", training_horizon=50)
    assert (timed.protocol.embedding, timed.protocol.horizon) == (TimeFeature(50), Fixed(50))
    with pytest.raises(PerdureError, match=r"training_horizon.*got 0"):
        imported("trpo", training_horizon=0)


def test_a_model_that_cannot_show_its_vecnormalize_gives_a_warning_unless_the_user_says_so():
    with pytest.warns(PerdureWarning, match=r"sac\.zip.*--normalizer none"):
        imported("sac", normalizer=None)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        imported("sac", normalizer="none")
        imported("trpo", normalizer=None)  # it shows that there was none


def test_statistics_for_a_model_that_had_none_give_a_warning():
    with pytest.warns(PerdureWarning, match=r"trpo\.zip was not.*ppo\.pkl"):
        imported("trpo", normalizer=FIXTURES / "ppo.pkl")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        imported("ppo", normalizer=FIXTURES / "ppo.pkl")


@pytest.mark.parametrize(("steps", "warned"), [(128, 0), (100, 0), (80, 1), (300, 1), (0, 0)])
def test_statistics_of_another_run_give_a_warning(tmp_path, steps, warned):
    """They saw 129 observations: 128 steps and a reset."""
    path = tmp_path / "model.zip"
    path.write_bytes(with_settings(lambda settings: settings.update(num_timesteps=steps, _n_updates=0)))
    with warnings.catch_warnings(record=True) as found:
        Policy.from_sb3(path, "Pendulum-v1", normalizer=FIXTURES / "ppo.pkl", measure=False)
    assert (
        sum(f"for {steps} steps" in str(each.message) and "for 129:" in str(each.message) for each in found) == warned
    )


def test_statistics_of_all_trainings_of_a_model_that_was_trained_further_give_no_warning(tmp_path):
    """The second training counts its own 40 steps; the number of updates is that of all 128 steps."""
    path = tmp_path / "model.zip"
    path.write_bytes(with_settings(lambda settings: settings.update(num_timesteps=40)))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        policy = Policy.from_sb3(path, "Pendulum-v1", normalizer=FIXTURES / "ppo.pkl", measure=False)
    assert policy.provenance["steps"] == 128


def test_an_environment_without_a_step_limit_gives_a_warning_that_names_the_flag():
    gymnasium.register("Endless-v0", PendulumEnv)
    try:
        with pytest.warns(PerdureWarning, match=r"1,000.*--training-horizon"):
            policy = imported("trpo", "Endless-v0")
        assert policy.protocol.horizon == Fixed(1000)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            assert imported("trpo", "Endless-v0", training_horizon=300).protocol.horizon == Fixed(300)
            assert imported("sac-time", "Endless-v0", time_feature="linear:300").protocol.horizon == Fixed(300)
    finally:
        del gymnasium.registry["Endless-v0"]


def test_the_statistics_are_those_that_stable_baselines3_used():
    """Its own file says so: the mean of the pendulum's speed over 128 steps, read with pickletools."""
    normalizer = imported("ppo", normalizer=FIXTURES / "ppo.pkl").normalizer
    assert (normalizer.clip, normalizer.epsilon) == (1.5, 1e-8)
    assert normalizer.mean.shape == normalizer.var.shape == (3,)
    assert (np.abs(normalizer.mean[:2]) <= 1).all()  # cosine and sine
    assert (normalizer.var > 0).all()


def test_a_policy_of_raw_observations_knows_their_spread_from_its_reference_episodes():
    blind, seeing = imported("trpo"), imported("trpo", measure=True)
    assert blind.observation_std.tolist() == [1.0, 1.0, 1.0]
    low, high = seeing.reference.observation_low, seeing.reference.observation_high
    np.testing.assert_allclose(seeing.observation_std, (high - low) / 12**0.5)
    assert seeing.observation_std[2] > 2 * seeing.observation_std[0]  # speeds up to 8, cosines up to 1
    normalized = imported("ppo", normalizer=FIXTURES / "ppo.pkl", measure=True)
    np.testing.assert_array_equal(normalized.observation_std, np.sqrt(normalized.normalizer.var))


def test_raw_observations_pass_unchanged():
    policy = imported("trpo")
    rows = np.random.default_rng(0).normal(scale=100, size=(50, 3))
    seen = policy.inputs(rows, policy.embed(np.zeros(50), np.ones(50)))
    np.testing.assert_array_equal(seen, rows.astype(np.float32))


def test_reference_episodes_are_measured_within_the_training_horizon():
    reference = imported("sac-time", time_feature="linear", measure=True).reference
    assert (reference.horizon, reference.lengths.tolist()) == (200, [200] * 20)


class TestImportOnce:
    def options(self, **changes):
        return {"normalizer": None, "time_feature": None, "trust": False} | changes

    def test_the_second_time_the_file_is_reused(self, tmp_path, monkeypatch):
        first = import_once(FIXTURES / "trpo.zip", tmp_path, "Pendulum-v1", **self.options())
        monkeypatch.setattr("perdure.policy.readers.sb3_import.import_sb3", None)  # a call would fail
        assert import_once(FIXTURES / "trpo.zip", tmp_path, "Pendulum-v1", **self.options()) == first
        assert load_policy(first).reference is not None

    def test_other_options_and_other_contents_make_another_file(self, tmp_path):
        path = tmp_path / "model.zip"
        path.write_bytes(model("trpo"))
        made = {import_once(path, tmp_path / "out", "Pendulum-v1", **self.options())}
        made.add(import_once(path, tmp_path / "out", "Pendulum-v1", **self.options(normalizer="none")))
        path.write_bytes(model("a2c"))
        statistics = str(FIXTURES / "a2c.pkl")
        made.add(import_once(path, tmp_path / "out", "Pendulum-v1", **self.options(normalizer=statistics)))
        assert made == set((tmp_path / "out").iterdir())
        assert len(made) == 3

    def test_a_damaged_file_is_made_again(self, tmp_path):
        made = import_once(FIXTURES / "trpo.zip", tmp_path, "Pendulum-v1", **self.options())
        whole = made.read_bytes()
        made.write_bytes(whole[:-10])
        assert import_once(FIXTURES / "trpo.zip", tmp_path, "Pendulum-v1", **self.options()) == made
        assert made.read_bytes() == whole


def test_a_model_is_known_by_its_name_or_its_first_bytes(tmp_path):
    bare, other = tmp_path / "model", tmp_path / "other"
    bare.write_bytes(model())
    other.write_bytes(b"safetensors")
    assert is_sb3_zip(bare)
    assert is_sb3_zip(tmp_path / "missing.ZIP")
    assert not is_sb3_zip(other)
    assert not is_sb3_zip(tmp_path)


def test_trust_says_what_to_install(monkeypatch):
    import sys

    monkeypatch.setitem(sys.modules, "stable_baselines3", None)
    monkeypatch.setitem(sys.modules, "stable_baselines3.common.save_util", None)
    with pytest.raises(PerdureError, match="stable-baselines3 sb3-contrib"):
        load_sb3(FIXTURES / "ppo.zip")
