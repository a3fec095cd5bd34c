"""What was computed with an environment of the user's own is not taken for the result of an edited one."""

import sys

import numpy as np
import pytest

from perdure.envs.suites import task_source_digest
from perdure.evaluate import Execution, Extrapolation, evaluate_files
from perdure.horizon import Fixed, HorizonProtocol
from perdure.learn import TrainRun, method_config
from perdure.policy import Normalizer, Policy, TaskInfo, save_policy

TASK = "gymnasium:edited_worlds.corridor:Corridor-v0"
CODE = """
import gymnasium
import numpy as np


class Corridor(gymnasium.Env):
    observation_space = gymnasium.spaces.Box(-1.0, 1.0, (2,))
    action_space = gymnasium.spaces.Box(-1.0, 1.0, (1,))

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        return np.zeros(2, np.float32), {{}}

    def step(self, action):
        return np.zeros(2, np.float32), {reward}, False, False, {{}}


gymnasium.register("Corridor-v0", Corridor, max_episode_steps=20)
"""


@pytest.fixture
def package(tmp_path, monkeypatch):
    folder = tmp_path / "edited_worlds"
    folder.mkdir()
    (folder / "__init__.py").write_text("")
    (folder / "corridor.py").write_text(CODE.format(reward=1.0))
    monkeypatch.syspath_prepend(str(tmp_path))
    yield folder
    for name in [name for name in sys.modules if name.startswith("edited_worlds")]:
        del sys.modules[name]


def edit(package, reward):
    (package / "corridor.py").write_text(CODE.format(reward=reward))
    for name in [name for name in sys.modules if name.startswith("edited_worlds")]:
        del sys.modules[name]


def policy(path):
    weights = {
        "policy.0.weight": np.zeros((2, 1), np.float32),
        "policy.0.bias": np.zeros(1, np.float32),
        "value.0.weight": np.zeros((2, 1), np.float32),
        "value.0.bias": np.zeros(1, np.float32),
        "log_std": np.zeros(1, np.float32),
    }
    task, protocol = TaskInfo(TASK, 2, (-1.0,), (1.0,)), HorizonProtocol(None, Fixed(20), "truncated", 0.9, 0.9)
    subject = Policy(task, weights, "tanh", Normalizer(np.zeros(2), np.ones(2)), protocol, None, {"method": "mine"})
    return save_policy(subject, path)


def test_lanes_of_an_edited_environment_are_run_again(package, tmp_path):
    path = policy(tmp_path / "policy.safetensors")
    asked = Extrapolation((path,), steps=30, eval_seeds=2, disturb=("none",), modules=("edited_worlds.corridor",))
    first = evaluate_files(asked, Execution(tmp_path / "out", on="here")).final["return"].to_list()
    assert first == [30.0, 30.0]
    assert evaluate_files(asked, Execution(tmp_path / "out", on="here")).final["return"].to_list() == first
    edit(package, reward=2.0)
    assert evaluate_files(asked, Execution(tmp_path / "out", on="here")).final["return"].to_list() == [60.0, 60.0]


def test_the_identity_of_a_training_run_has_the_whole_package(package):
    run = TrainRun(TASK, "ppo", method_config("ppo", TASK, 2))
    before = run.identity(0)
    assert run.identity(0) == before
    edit(package, reward=2.0)
    assert run.identity(0) != before
    assert "source" not in TrainRun("Hopper-v3", "ppo", method_config("ppo", "Hopper-v3", 11)).identity(0)


@pytest.mark.parametrize("kind", ["package", "folder"])
def test_so_has_the_digest_with_its_robot_and_without_an_init_file(package, kind):
    if kind == "folder":
        (package / "__init__.py").unlink()
    robot, found = package / "assets" / "robot.xml", [task_source_digest(TASK)]
    robot.parent.mkdir()
    for text in ("<mujoco/>", "<mujoco model='other'/>"):
        robot.write_text(text)
        found.append(task_source_digest(TASK))
    edit(package, reward=2.0)
    found.append(task_source_digest(TASK))
    assert all(list(each) == ["edited_worlds"] for each in found)
    assert len({each["edited_worlds"] for each in found}) == 4


@pytest.mark.parametrize("task", ["Hopper-v3", "gymnasium:Pendulum-v1", "gymnasium:no_such_module:Id-v0"])
def test_other_tasks_have_no_source_of_the_user_s(task):
    assert task_source_digest(task) == {}
