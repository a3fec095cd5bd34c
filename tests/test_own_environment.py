"""Train, evaluate and report on an environment that only its user knows, in one process."""

import gymnasium
import numpy as np
import pytest

from perdure import extrapolate
from perdure.horizon import Geometric, HorizonProtocol, Uniform
from perdure.learn import PPOConfig, TrainRun, train

TASK = "gymnasium:perdure-Thermostat-v0"
TRAINED, LONG = 9, 60


class Thermostat(gymnasium.Env):
    """Shows how far a room is too warm, heats or cools it, and pays 1 less what is missing."""

    observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (1,), np.float64)
    action_space = gymnasium.spaces.Box(-1.0, 1.0, (1,), np.float64)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.excess = self.np_random.uniform(-1.0, 1.0)
        return np.array([self.excess]), {}

    def step(self, action):
        self.excess += float(action[0])
        return np.array([self.excess]), 1.0 - abs(self.excess), False, False, {}


@pytest.fixture(autouse=True)
def registered():
    gymnasium.register(TASK.partition(":")[2], Thermostat)
    yield
    del gymnasium.registry[TASK.partition(":")[2]]


def test_an_own_environment_is_learned_evaluated_and_reported(tmp_path):
    law = Uniform(3, TRAINED)
    protocol = HorizonProtocol(Geometric(4, low=0.5), law, "terminated", gamma=1.0, normalizer_gamma=1.0)
    config = PPOConfig(
        protocol=protocol, n_envs=4, n_steps=128, batch_size=128, hidden_sizes=(16,), learning_rate=5e-3,
        total_steps=512 * 14,
    )  # fmt: skip
    (path,) = train(TrainRun(TASK, "mine", config), tmp_path / "runs", cores=1)
    options = {"steps": LONG, "eval_seeds": 4, "clocks": f"constant:{TRAINED}", "disturb": "none", "on": "here"}
    result = extrapolate(path, **options)
    assert result.final["step"].to_list() == [LONG] * 4
    returns = np.array(result.final["return"])
    # Nothing done pays 0.5 a step on average; the room is right after two steps at most.
    assert np.all(returns > 0.8 * LONG), returns
    page = result.write(tmp_path / "report").read_text()
    assert "perdure-Thermostat-v0" in page
    assert "mine" in page
