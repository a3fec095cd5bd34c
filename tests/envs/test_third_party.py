"""Environments that break the rules are named, with method and step; nothing they return is bent into shape."""

from __future__ import annotations

import sys

import gymnasium
import numpy as np
import pytest

from perdure.envs import GymnasiumWorld, VectorEnvWorld, make_world
from perdure.errors import PerdureError
from perdure.learn import PPOConfig, TrainRun, train
from perdure.policy import FunctionPolicy, TaskInfo, measure_reference


class Broken(gymnasium.Env):
    """Works until step 3, where `returns` takes the place of what a step returns."""

    observation_space = gymnasium.spaces.Box(-1.0, 1.0, (3,), np.float64)
    action_space = gymnasium.spaces.Box(-1.0, 1.0, (1,), np.float64)

    def __init__(self, returns=None, resets=None):
        self.returns, self.resets, self.steps = returns, resets, 0

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.steps = 0
        return self.resets() if self.resets else (np.zeros(3), {})

    def step(self, action):
        self.steps += 1
        if self.steps == 3 and self.returns:
            return self.returns()
        return np.zeros(3), 1.0, False, False, {}


def raises(error):
    def function():
        raise error

    return function


FAULTS = {
    "shrunk": (
        lambda: (np.zeros(1), 1.0, False, False, {}),
        r"step returned an observation of shape \(1,\), not \(3,\)",
    ),
    "scalar": (lambda: (0.0, 1.0, False, False, {}), r"shape \(\), not \(3,\)"),
    "grown": (lambda: (np.zeros((3, 3)), 1.0, False, False, {}), r"shape \(3, 3\)"),
    "complex": (lambda: (np.zeros(3, complex), 1.0, False, False, {}), "complex128; it must be real numbers"),
    "text": (lambda: (np.array(["a", "b", "c"]), 1.0, False, False, {}), "must be real numbers"),
    "none": (lambda: (None, 1.0, False, False, {}), "must be real numbers"),
    "ragged": (lambda: ([[1], [1, 2], 3], 1.0, False, False, {}), "does not fit"),
    "two rewards": (lambda: (np.zeros(3), np.ones(2), False, False, {}), "reward must be a real number"),
    "complex reward": (lambda: (np.zeros(3), 1j, False, False, {}), "reward must be a real number"),
    "text reward": (lambda: (np.zeros(3), "1", False, False, {}), "reward must be a real number, it is '1'"),
    "no": (lambda: (np.zeros(3), 1.0, "no", False, {}), "terminated must be True or False, it is 'no'"),
    "None": (lambda: (np.zeros(3), 1.0, False, None, {}), "truncated must be True or False, it is None"),
    "two": (lambda: (np.zeros(3), 1.0, 2, False, {}), "terminated must be True or False, it is 2"),
    "old gym": (lambda: (np.zeros(3), 1.0, False, {}), "step must return 5 values, it returned 4 values"),
    "nothing": (lambda: None, "step must return 5 values, it returned None"),
    "error": (raises(ZeroDivisionError("division\n by zero")), "step raised ZeroDivisionError: division by zero"),
    "exit": (raises(SystemExit(3)), "step raised SystemExit: 3"),
}


@pytest.mark.parametrize(("returns", "said"), FAULTS.values(), ids=FAULTS)
def test_a_step_that_breaks_the_rules_is_refused_by_name_and_step(returns, said):
    world = GymnasiumWorld([Broken, lambda: Broken(returns)], [0, 1], "mine")
    world.reset()
    for _ in range(2):
        world.step(np.zeros((2, 1)))
    with pytest.raises(PerdureError, match=said) as refusal:
        world.step(np.zeros((2, 1)))
    assert str(refusal.value).startswith("mine, lane 1, step 3: ")
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize(
    ("resets", "said"),
    [
        (lambda: np.zeros(3), "reset must return 2 values, it returned ndarray"),
        (lambda: (np.zeros(2), {}), r"reset returned an observation of shape \(2,\)"),
        (raises(RuntimeError("no display")), "reset raised RuntimeError: no display"),
    ],
)
def test_a_reset_that_breaks_the_rules_is_refused_too(resets, said):
    with pytest.raises(PerdureError, match=f"mine, lane 0: {said}"):
        GymnasiumWorld([lambda: Broken(resets=resets)], [0], "mine").reset()


def test_numbers_of_other_kinds_are_taken_for_what_they_are():
    returns = lambda: (np.array([1, 2, 3], np.int8), np.float32(2.5), np.bool_(True), 0, {})  # noqa: E731
    world = GymnasiumWorld([lambda: Broken(returns)], [0])
    world.reset()
    step = [world.step(np.zeros((1, 1))) for _ in range(3)][-1]
    assert step.observations.tolist() == [[1.0, 2.0, 3.0]]
    assert (step.rewards[0], step.terminated[0], step.truncated[0]) == (2.5, True, False)


def test_an_environment_that_cannot_be_made_is_named():
    with pytest.raises(PerdureError, match=r"mine.*no such robot"):
        GymnasiumWorld([raises(OSError("no such robot"))], [0], "mine")


class TestVectors:
    @pytest.mark.parametrize(
        ("change", "said"),
        [
            (lambda o, r, e, c, i: (o[:, :1], r, e, c, i), r"observations of shape \(2, 3\)"),
            (lambda o, r, e, c, i: (o.astype(complex), r, e, c, i), "real numbers, it returned complex128"),
            (lambda o, r, e, c, i: (o, r[:1], e, c, i), r"rewards must be real numbers of shape \(2,\)"),
            (lambda o, r, e, c, i: (o, r, e.astype(str), c, i), "terminated must be bools"),
            (lambda o, r, e, c, i: (o, r, e, i), "step must return 5 values"),
        ],
    )
    def test_what_breaks_the_rules_is_refused(self, change, said, monkeypatch):
        env = gymnasium.vector.SyncVectorEnv([Broken, Broken])
        world = VectorEnvWorld(env, [0, 1], "mine")
        world.reset()
        whole = env.step
        monkeypatch.setattr(env, "step", lambda actions: change(*whole(actions)))
        with pytest.raises(PerdureError, match=f"mine: .*{said}"):
            world.step(np.zeros((2, 1)))


@pytest.fixture
def module(tmp_path, monkeypatch):
    """A module that registers an environment which fails in its third step, and leaves a trace when imported."""
    name = "perdure_test_broken"
    (tmp_path / f"{name}.py").write_text(
        "import gymnasium, numpy as np, pathlib\n"
        "pathlib.Path(__file__).with_name('imported').touch()\n"
        "class Env(gymnasium.Env):\n"
        "    observation_space = gymnasium.spaces.Box(-1.0, 1.0, (3,))\n"
        "    action_space = gymnasium.spaces.Box(-1.0, 1.0, (1,))\n"
        "    def reset(self, *, seed=None, options=None):\n"
        "        self.steps = 0\n"
        "        return np.zeros(3, np.float32), {}\n"
        "    def step(self, action):\n"
        "        self.steps += 1\n"
        "        if self.steps == 3:\n"
        "            raise KeyError('joint')\n"
        "        return np.zeros(3, np.float32), 1.0, False, False, {}\n"
        "gymnasium.register('Broken-v0', Env)\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    yield name
    sys.modules.pop(name, None)
    gymnasium.registry.pop("Broken-v0", None)


SHORT = PPOConfig(n_envs=1, n_steps=8, batch_size=8, total_steps=8)


@pytest.mark.parametrize("on", ["here", "local"])
def test_training_says_in_one_line_which_environment_broke_where(module, tmp_path, on):
    with pytest.raises(ValueError, match="raised KeyError: 'joint'") as refusal:
        train(TrainRun(f"gymnasium:{module}:Broken-v0", "ppo", SHORT), tmp_path / "out", on=on, cores=1)
    message = str(refusal.value)
    assert f"gymnasium:{module}:Broken-v0, lane 0, step 3: step raised" in message
    assert "JAX" not in message
    assert len(message.splitlines()) == 1


def test_a_module_that_cannot_be_imported_is_named(tmp_path, monkeypatch):
    (tmp_path / "perdure_test_exits.py").write_text("import sys; sys.exit('bye')")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(PerdureError, match=r"perdure_test_exits.*bye"):
        make_world("gymnasium:perdure_test_exits:Id-v0", [0])
    with pytest.raises(PerdureError, match=r"perdure_test_absent.*PYTHONPATH"):
        make_world("gymnasium:perdure_test_absent:Id-v0", [0])


@pytest.mark.parametrize("reward", [float("nan"), 1e308])
def test_training_names_the_environment_whose_rewards_nobody_can_learn_from(tmp_path, reward):
    gymnasium.register("perdure-test-Unpaid-v0", lambda: Broken(lambda: (np.zeros(3), reward, False, False, {})))
    with pytest.raises(PerdureError, match=r"Unpaid-v0.*reward") as refusal:
        train(TrainRun("gymnasium:perdure-test-Unpaid-v0", "ppo", SHORT), tmp_path / "out", cores=1)
    assert "JAX" not in str(refusal.value)
    gymnasium.registry.pop("perdure-test-Unpaid-v0")


def test_a_reward_whose_sums_overflow_is_named():
    world = GymnasiumWorld([lambda: Dazzling()], [0], "mine", default_horizon=10)
    policy = FunctionPolicy(lambda seen: np.zeros((len(seen), 1)), TaskInfo("mine", 3, (-1.0,), (1.0,)))
    with pytest.raises(PerdureError, match=r"mine, lane 0, step 1: the reward is 1e\+308"):
        measure_reference(policy, 1, world)


class Dazzling(Broken):
    def step(self, action):
        return np.zeros(3), 1e308, False, False, {}


def test_robots_are_made_without_advice_to_their_authors(capfd):
    """HalfCheetah's file has settotalmass, which MuJoCo calls deprecated, once for each environment."""
    pytest.importorskip("mujoco")
    make_world("gymnasium:HalfCheetah-v5", [0, 1, 2]).close()
    assert "deprecated" not in "".join(capfd.readouterr())
