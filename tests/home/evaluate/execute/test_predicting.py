"""Anybody's policy acts in the protocol as a shipped one does."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from perdure.errors import PerdureError
from perdure.home.agents.learned import Learned, Predicting
from perdure.home.evaluate.execute import Executor, ExecutorOptions
from perdure.home.evaluate.policies import choose_policies, make_agents
from perdure.home.evaluate.protocol import EvaluationProtocol
from perdure.home.sim.scene import EARLIER, SceneOptions
from perdure.home.skills import get_skill
from perdure.home.tasks.episodes import load_episodes

ROOT = Path(__file__).parents[4]


def test_a_function_acts_as_the_policy_that_it_calls():
    chosen = choose_policies("set_table", 0)
    shipped = make_agents(chosen, "rl")
    policies = {skill: each.policy for skill, each in chosen.items()}
    foreign = {
        skill: Predicting(lambda seen, policy=policies[skill]: policy.act(seen, np.zeros(len(seen), int)))
        for skill in policies
    }
    assert all(isinstance(shipped[skill], Learned) for skill in policies)
    episodes = load_episodes("set_table", "val").episodes[3:5]
    options = ExecutorOptions(lanes=2, settle_steps=2, scene=SceneOptions(**EARLIER))  # as they were trained
    ran = []
    for agents in (shipped, {**shipped, **foreign}):
        logs = list(Executor(EvaluationProtocol("set_table").skills(), agents, options).run(episodes))
        ran.append({log.index: [(run.skill, run.begin, run.end, run.ending) for run in log.runs] for log in logs})
    assert ran[0] == ran[1]
    assert all([run[0] for run in runs].count("place") == 2 for runs in ran[0].values())


@pytest.mark.parametrize(("skill", "size"), [("place", 11), ("navigate", 10), ("place", None)])
def test_actions_of_another_shape_are_refused(skill, size, monkeypatch):
    skill = get_skill(skill)
    monkeypatch.setattr(type(skill), "observe", lambda self, state, progress: np.zeros((3, len(self.elements))))
    agent = Predicting(lambda seen: np.zeros(len(seen)) if size is None else np.zeros((len(seen), size)))
    with pytest.raises(PerdureError, match=rf"predict gave actions of shape .* for {skill.name}; it must be \(3, "):
        agent.act(None, np.arange(3), skill, None, None)


def test_the_sb3_example_learns_and_runs_the_protocol(tmp_path):
    pytest.importorskip("stable_baselines3")
    command = [sys.executable, ROOT / "examples" / "sb3_home_place.py", "--train-steps", "4096", "--lanes", "2"]
    command += ["--episodes", "1", "--out", tmp_path]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert [path.name for path in sorted(tmp_path.iterdir())] == ["sb3-ik.parquet", "sb3-rl.parquet"]
    assert "sb3 ik:" in done.stdout
