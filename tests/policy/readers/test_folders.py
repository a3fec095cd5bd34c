"""Folders of RL Baselines3 Zoo, written as it writes them, and folders of checkpoints."""

from __future__ import annotations

import contextlib
from collections import OrderedDict

import pytest
import yaml
from altered import FIXTURES

from perdure.errors import PerdureError
from perdure.policy.readers import find_models

ARGS = {"algo": "ppo", "env": "Pendulum-v1", "env_kwargs": None, "gym_packages": [], "seed": 594371, "uuid": True}
CONFIG = {
    **{"gamma": 0.98, "n_timesteps": 1e6, "normalize": True, "policy": "MlpPolicy"},
    "policy_kwargs": "dict( log_std_init=-2, ortho_init=False, activation_fn=nn.ReLU, net_arch=[dict(pi=[256, 256])] )",
}


def write(path, values):
    path.write_text(yaml.dump(OrderedDict(sorted(values.items()))))


@pytest.fixture
def run(tmp_path):
    """A finished run: the last model, the best one, checkpoints."""
    folder = tmp_path / "ppo" / "Pendulum-v1_1"
    (folder / "Pendulum-v1").mkdir(parents=True)
    for name in ("Pendulum-v1", "best_model", "rl_model_100000_steps", "rl_model_20000_steps"):
        (folder / f"{name}.zip").write_bytes((FIXTURES / "ppo.zip").read_bytes())
    (folder / "Pendulum-v1" / "vecnormalize.pkl").write_bytes((FIXTURES / "ppo.pkl").read_bytes())
    write(folder / "Pendulum-v1" / "args.yml", ARGS)
    write(folder / "Pendulum-v1" / "config.yml", CONFIG)
    return folder


def names(models):
    return [each.path.name for each in models]


def test_the_last_model_of_a_run_is_taken_with_its_environment_and_normalizer(run):
    said = []
    (model,) = find_models(run, said.append)
    assert (model.path, model.env, model.time_feature, model.unread) == (
        run / "Pendulum-v1.zip",
        "Pendulum-v1",
        None,
        "",
    )
    assert model.normalizer == str(run / "Pendulum-v1" / "vecnormalize.pkl")
    assert all(part in said[0] for part in ("Pendulum-v1_1 holds", "best_model.zip", "evaluating Pendulum-v1.zip"))


def test_the_best_model_comes_next_then_all_checkpoints_by_their_steps(run):
    (run / "Pendulum-v1.zip").unlink()
    assert names(find_models(run)) == ["best_model.zip"]
    (run / "best_model.zip").unlink()
    assert names(find_models(run)) == ["rl_model_20000_steps.zip", "rl_model_100000_steps.zip"]


def test_a_named_file_of_a_run_has_the_same_settings(run):
    own = run / "rl_model_vecnormalize_20000_steps.pkl"
    own.touch()
    (best,), (checkpoint,) = (find_models(run / name) for name in ("best_model.zip", "rl_model_20000_steps.zip"))
    assert best.normalizer == str(run / "Pendulum-v1" / "vecnormalize.pkl")
    assert (checkpoint.env, checkpoint.normalizer) == ("Pendulum-v1", str(own))


@pytest.mark.parametrize(
    ("change", "found"),
    [
        ({"env_wrapper": "sb3_contrib.common.wrappers.TimeFeatureWrapper"}, ("linear", "")),
        ({"env_wrapper": ["sb3_contrib.common.wrappers.TimeFeatureWrapper"]}, ("linear", "")),
        ({"env_wrapper": [{"a.Wrapper": {"size": 0.5}}]}, (None, "env_wrapper - a.Wrapper: size: 0.5")),
        ({"frame_stack": 4}, (None, "frame_stack 4")),
        ({"frame_stack": 1}, (None, "")),
    ],
)
def test_wrappers_of_a_run_are_known(run, change, found):
    write(run / "Pendulum-v1" / "config.yml", CONFIG | change)
    (model,) = find_models(run)
    assert (model.time_feature, model.unread) == found


def test_arguments_of_the_environment_are_known(run):
    write(run / "Pendulum-v1" / "args.yml", ARGS | {"env_kwargs": {"g": 9.0}})
    assert find_models(run)[0].unread == "env_kwargs g: 9.0"


def test_statistics_are_left_alone_where_the_run_did_not_normalize_and_missed_where_it_did(run):
    write(run / "Pendulum-v1" / "config.yml", CONFIG | {"normalize": False})
    assert find_models(run)[0].normalizer == "none"
    write(run / "Pendulum-v1" / "config.yml", CONFIG | {"normalize": "dict(norm_obs=True, norm_reward=False)"})
    assert find_models(run)[0].normalizer.endswith("vecnormalize.pkl")
    (run / "Pendulum-v1" / "vecnormalize.pkl").unlink()
    with pytest.raises(PerdureError, match=r"vecnormalize\.pkl"):
        find_models(run)


def test_settings_never_run(run, tmp_path):
    trace = tmp_path / "trace"
    attack = f"!!python/object/apply:os.system ['touch {trace}']"
    for text in (attack, f"!!python/object/apply:collections.OrderedDict\n- - - env\n    - {attack}\n"):
        (run / "Pendulum-v1" / "args.yml").write_text(text)
        with contextlib.suppress(PerdureError):
            assert find_models(run)[0].env == attack
    assert not trace.exists()


def test_checkpoints_of_other_trainings_say_nothing_but_their_own_statistics(tmp_path):
    for steps in (900, 1000):
        (tmp_path / f"walker_{steps}_steps.zip").touch()
    (tmp_path / "walker_vecnormalize_900_steps.pkl").touch()
    first, second = find_models(tmp_path)
    assert (first.path.name, first.normalizer, first.env) == (
        "walker_900_steps.zip",
        str(tmp_path / "walker_vecnormalize_900_steps.pkl"),
        None,
    )
    assert (second.path.name, second.normalizer) == ("walker_1000_steps.zip", None)


def test_other_paths_mean_no_model(tmp_path):
    (tmp_path / "policy.safetensors").touch()
    assert find_models(tmp_path) == find_models(tmp_path / "gone") == find_models(tmp_path / "policy.safetensors") == []
