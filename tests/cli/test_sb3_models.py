"""Models of Stable-Baselines3 on the command line."""

from __future__ import annotations

import json
from functools import partial
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from perdure.evaluate.reference import measure_idle
from perdure.policy import Policy, load_policy
from perdure.policy.onnx import export_onnx

FIXTURES = Path(__file__).parents[1] / "policy" / "readers" / "fixtures"
MODEL, STATISTICS = FIXTURES / "ppo.zip", FIXTURES / "ppo.pkl"
FLAGS = ("--env", "Pendulum-v1", "--normalizer", STATISTICS)
SHORT = ("--steps", 30, "--eval-seeds", 2, "--disturb", "none", "--on", "here")


@pytest.fixture(scope="module")
def evaluated(command, tmp_path_factory):
    """A folder in which a model was evaluated, and what the command said."""
    folder = tmp_path_factory.mktemp("evaluated")
    return folder, command("extrapolate", MODEL, *FLAGS, *SHORT, "--out", "results", cwd=folder)


def test_a_model_is_imported_and_evaluated(evaluated):
    folder, process = evaluated
    assert process.returncode == 0, process.stderr
    assert process.stderr.startswith(f"perdure: reading {MODEL}\n")
    assert "SB3 PPO (ppo)" in process.stdout
    assert (folder / "results" / "report.html").exists()
    frame = pl.read_parquet(folder / "results" / "episodes.parquet")
    assert frame["task"].unique().to_list() == ["gymnasium:Pendulum-v1"]
    (file,) = (folder / "results" / "imported").iterdir()
    assert len(load_policy(file).reference.lengths) == 20


def test_the_same_command_imports_and_evaluates_nothing_again(evaluated, command):
    folder, _ = evaluated
    (file,) = (folder / "results" / "imported").iterdir()
    before = file.stat().st_mtime_ns
    again = command("extrapolate", MODEL, *FLAGS, *SHORT, "--out", "results", cwd=folder)
    assert again.returncode == 0, again.stderr
    assert again.stderr.splitlines() == [f"perdure: reading {MODEL}"]  # no progress: every lane is there
    assert file.stat().st_mtime_ns == before


def test_import_writes_a_policy_file_that_extrapolate_and_inspect_take(command, tmp_path):
    made = command("import", MODEL, *FLAGS, "--out", "made.safetensors", cwd=tmp_path)
    assert (made.returncode, made.stdout) == (0, "made.safetensors\n"), made.stderr
    text = command("inspect", "made.safetensors", cwd=tmp_path).stdout
    for part in ("gymnasium:Pendulum-v1", "tanh", "Fixed(steps=200)", "SB3 PPO (ppo)", "20 episodes"):
        assert part in text
    done = command("extrapolate", "made.safetensors", *SHORT, cwd=tmp_path)
    assert done.returncode == 0, done.stderr


def test_import_does_not_replace_a_file(command, tmp_path):
    (tmp_path / "made.safetensors").write_text("mine")
    made = command("import", MODEL, *FLAGS, "--out", "made.safetensors", cwd=tmp_path)
    assert made.returncode == 2
    assert "made.safetensors exists" in made.stderr
    assert (tmp_path / "made.safetensors").read_text() == "mine"


def test_a_policy_that_never_worked_without_a_normalizer_gets_a_hint(command, tmp_path):
    asked = ("extrapolate", MODEL, "--env", "Pendulum-v1", "--normalizer", "none", *SHORT)
    made = command(*asked, "--training-horizon", 20, cwd=tmp_path)
    assert "never worked" in made.stdout
    assert "vecnormalize.pkl" in made.stderr


def test_a_training_horizon_is_that_of_the_policy_file(command, tmp_path):
    made = command("import", MODEL, *FLAGS, "--training-horizon", 50, "--out", "made.safetensors", cwd=tmp_path)
    assert made.returncode == 0, made.stderr
    assert "Fixed(steps=50)" in command("inspect", "made.safetensors", cwd=tmp_path).stdout
    refused = command("extrapolate", "made.safetensors", "--training-horizon", 50, *SHORT, cwd=tmp_path)
    assert refused.returncode == 2
    assert "--training-horizon" in refused.stderr


def test_several_models_share_the_flags_and_a_time_feature_takes_clocks(command, tmp_path):
    model, copy = FIXTURES / "sac-time.zip", tmp_path / "second.zip"
    copy.write_bytes(model.read_bytes())
    process = command(
        *("extrapolate", model, copy, "--env", "Pendulum-v1", "--time-feature", "linear", *SHORT),
        *("--clocks", "default", "constant:200", "periodic:200"),
        cwd=tmp_path,
    )
    assert process.returncode == 0, process.stderr
    frame = pl.read_parquet(tmp_path / "extrapolation" / "episodes.parquet")
    assert set(frame["policy"].unique()) == {"SB3 SAC (sac-time)", "SB3 SAC (second)"}
    assert set(frame["clock"].unique()) == {"countdown(200)", "constant(200)", "periodic(200)"}


WALLS = """
import gymnasium
from gymnasium.envs.classic_control import PendulumEnv
gymnasium.register("Walled-v0", PendulumEnv, max_episode_steps=200)
"""


def test_a_module_named_in_env_is_imported(command, tmp_path, monkeypatch):
    (tmp_path / "walls.py").write_text(WALLS)
    monkeypatch.syspath_prepend(tmp_path)
    process = command("extrapolate", FIXTURES / "trpo.zip", "--env", "walls:Walled-v0", *SHORT, cwd=tmp_path)
    assert process.returncode == 0, process.stderr


PAID = """
import gymnasium
import numpy as np

class Paid(gymnasium.Env):
    observation_space = gymnasium.spaces.Box(-8.0, 8.0, (3,))
    action_space = gymnasium.spaces.Box(-2.0, 2.0, (1,))
    shown = np.array({shown}, np.float32)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.last = None
        return self.shown, {{}}

    def step(self, action):
        changed = 0.0 if self.last is None else abs(action[0] - self.last)
        self.last = action[0]
        return self.shown, float(action[0] - 10.0 * changed), False, False, {{}}

gymnasium.register("Paid-v0", Paid, max_episode_steps=20)
"""
"""Shows one observation, and pays the action: what a policy earns is known. Random actions earn less than none."""


@pytest.fixture(scope="module")
def two_models(tmp_path_factory):
    """A folder with that environment, and what the two models do there, as Stable-Baselines3 recorded it."""
    folder = tmp_path_factory.mktemp("two_models")
    with np.load(FIXTURES / "actions.npz") as recorded:
        actions = [recorded[name][:, 0] for name in ("trpo", "td3")]
        place = np.flatnonzero((actions[0] > 0.2) & (actions[1] > 1.5 * actions[0]))[0]
        shown = recorded["observations"][place].tolist()
    (folder / "paid.py").write_text(PAID.format(shown=shown))
    return folder, float(actions[0][place] / actions[1][place])


@pytest.mark.parametrize("kind", ["zip", "onnx"])
def test_two_models_are_compared(kind, two_models, command, monkeypatch):
    folder, share = two_models
    monkeypatch.syspath_prepend(folder)
    monkeypatch.setattr("perdure.evaluate.reference.measure_idle", partial(measure_idle, steps=100))
    files = [FIXTURES / "trpo.zip", FIXTURES / "td3.zip"]
    flags = ["--env", "paid:Paid-v0", "--steps", 20, "--disturb", "none", "--on", "here", "--json", "--out", kind]
    if kind == "zip":
        flags += ["--normalizer", "none"]
    else:
        files = [export_onnx(imported(path), folder / f"{path.stem}.onnx") for path in files]
    process = command("compare", *files, *flags, cwd=folder)
    assert process.returncode == 0, process.stderr
    answer = json.loads(process.stdout)
    assert answer["verdict"] == "better"
    work = next(each for each in answer["measures"] if each["measure"] == "work")
    assert work["b"]["estimate"] == pytest.approx(1.0)
    assert work["a"]["estimate"] == pytest.approx(share, abs=1e-5)


def imported(path):
    return Policy.from_sb3(path, "gymnasium:Pendulum-v1", normalizer="none", measure=False)


MISTAKES = {
    "no environment": ("--env Hopper-v5", (MODEL,)),
    "unknown environment": ("did you mean", (MODEL, "--env", "Pendulom-v1")),
    "another environment": ("takes 3 numbers", (MODEL, "--env", "Hopper-v5", "--normalizer", "none")),
    "a normalizer forgotten": ("--normalizer", (MODEL, "--env", "Pendulum-v1")),
    "a missing normalizer": ("nowhere.pkl", (MODEL, "--env", "Pendulum-v1", "--normalizer", "nowhere.pkl")),
    "a device as normalizer": ("not a regular file", (MODEL, "--env", "Pendulum-v1", "--normalizer", "/dev/zero")),
    "a model as normalizer": ("ppo.zip", (MODEL, "--env", "Pendulum-v1", "--normalizer", MODEL)),
    "a time feature that is none": ("linear:1000", (*(MODEL, *FLAGS), "--time-feature", "1000")),
    "trust without the library": ("pip install stable-baselines3", (MODEL, *FLAGS, "--trust")),
    "a missing model": ("gone.zip", ("gone.zip", *FLAGS)),
    "a policy of our own": ("--env", ("Hopper-v3/geometric", "--env", "Hopper-v3")),
    "trust in a policy of our own": ("--trust", ("Hopper-v3/geometric", "--trust")),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_ends_in_one_line(command, mistake, tmp_path):
    if mistake.startswith("trust without") and find_spec("stable_baselines3"):
        pytest.skip("Stable-Baselines3 is installed")
    named, arguments = MISTAKES[mistake]
    refused = command("extrapolate", *arguments, *SHORT, cwd=tmp_path)
    assert (refused.returncode, refused.stdout) == (2, "")
    *before, line = refused.stderr.splitlines()
    assert [each for each in before if not each.startswith("perdure: reading ")] == []
    assert line.startswith("perdure: ")
    assert named in line


def test_a_time_feature_of_other_steps_than_the_environments_limit_gives_a_warning(command, tmp_path):
    arguments = (
        "import",
        FIXTURES / "sac-time.zip",
        "--env",
        "Pendulum-v1",
        "--time-feature",
        "linear:50",
        "--normalizer",
        "none",
    )
    process = command(*arguments, cwd=tmp_path)
    assert process.returncode == 0
    assert process.stderr.count("\n") == 1
    assert "counts down from 50 steps, but episodes of gymnasium:Pendulum-v1 end after 200" in process.stderr
    assert np.isclose(load_policy(tmp_path / "policy.safetensors").protocol.embedding.steps, 50)
