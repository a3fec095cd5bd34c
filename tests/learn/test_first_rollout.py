"""Where an early end pays better than going on, training says so once and names the flag."""

from dataclasses import replace

import gymnasium
import numpy as np
import pytest

from perdure.errors import PerdureWarning
from perdure.learn import TrainRun, method_config, train
from perdure.learn.advantages import Ends
from perdure.learn.first_rollout import EARLY_ENDS, REWARD, first_rollout_facts
from perdure.learn.rollout import Episodes

TINY = {"n_steps": 32, "batch_size": 32, "total_steps": 64, "n_epochs": 1, "hidden_sizes": (4,)}
EARLY = {REWARD: -0.5, EARLY_ENDS: 3.0}


def test_the_facts_are_those_of_a_rollout_worked_out_by_hand():
    """Two environments, three steps. Rewards: -1, -1, -1 with a fall after two steps; 2, 2, 2 with a time limit."""
    returns = np.array([[-1.0, 2.0], [-2.0, 4.0], [-1.0, 6.0]])
    no = np.zeros((3, 2), bool)
    fell = no.copy()
    fell[1, 0] = True
    cut = no.copy()
    cut[2, 1] = True
    facts = first_rollout_facts(Episodes(returns, np.ones((3, 2)), fell | cut), Ends(fell, cut, no))
    assert facts == {REWARD: (-3 + 6) / 6, EARLY_ENDS: 1}


def test_it_is_said_where_nothing_limits_what_an_early_end_pays():
    geometric = method_config("geometric", "Ant-v4", 27)
    assert "--ppo.log-std-init -2" in geometric.advice(EARLY), "less than the preset's -1"
    assert "--ppo.log-std-init -1" in replace(geometric, log_std_init=0.0).advice(EARLY)
    for facts in ({}, {**EARLY, REWARD: 0.1}, {**EARLY, EARLY_ENDS: 0.0}):
        assert geometric.advice(facts) == ""
    for method in ("ppo", "ppo-average-reward"):
        assert method_config(method, "Ant-v4", 27).advice(EARLY) == ""


class Costly(gymnasium.Env):
    """Each step costs 1; an episode ends after five."""

    observation_space = gymnasium.spaces.Box(-1, 1, (2,))
    action_space = gymnasium.spaces.Box(-1, 1, (1,))
    count = 0

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.count = 0
        return np.zeros(2, np.float32), {}

    def step(self, action):
        self.count += 1
        return np.zeros(2, np.float32), -1.0, self.count == 5, False, {}


@pytest.fixture
def costly():
    gymnasium.register("Costly-v0", Costly, max_episode_steps=1000)
    yield "gymnasium:Costly-v0"
    del gymnasium.registry["Costly-v0"]


def test_it_is_said_once_in_a_run(costly, tmp_path):
    config = replace(method_config("geometric", costly, 2), **TINY)
    with pytest.warns(PerdureWarning, match="log-std-init -1") as caught:
        train(TrainRun(costly, "geometric", config), tmp_path, cores=1)
    assert len(caught) == 1
