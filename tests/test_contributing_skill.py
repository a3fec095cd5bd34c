"""The skill of CONTRIBUTING.md: one file is trained, runs in a plan and documents itself."""

import importlib.util
from dataclasses import replace
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from test_contributing import run  # noqa: F401  a fixture

from perdure.home.agents import Learned, Predicting, Scripted
from perdure.home.benchmark.episodes import load_episodes
from perdure.home.benchmark.tasks import SET_TABLE, TASKS
from perdure.home.benchmark.tasks.task import with_resets
from perdure.home.errors import HomeError
from perdure.home.evaluate.execute import Executor, ExecutorOptions
from perdure.home.evaluate.protocol import choose_policies
from perdure.home.skills import SKILLS, get_skill
from perdure.home.skills.gym import env_id, register
from perdure.home.skills.training import train_skill
from perdure.policy import load_policy

NAME = "raise_hand"
TOOL = Path(__file__).parents[1] / "tools" / "skill_tables.py"
ELBOW_FLEX = 5


@pytest.fixture
def skill(run, monkeypatch):  # noqa: F811
    """The skill, registered by its one line."""
    kind = run("A skill").RaiseHand
    monkeypatch.setitem(SKILLS, NAME, kind)
    register()
    yield get_skill(NAME)
    del gymnasium.registry[env_id(NAME)]


@pytest.fixture
def episode(monkeypatch):
    """An episode of a task whose plan uses the skill."""
    plan = with_resets(("navigate", 0), (NAME, 0))
    monkeypatch.setitem(TASKS, "wave", replace(SET_TABLE, name="wave", skills=plan))
    return replace(load_episodes("set_table", "val")[0], task="wave")


def lift(observations):
    """Turn the elbow upward."""
    actions = np.zeros((len(observations), 10))
    actions[:, ELBOW_FLEX] = -1.0
    return actions


def rest(observations):
    return np.zeros((len(observations), 10))


def run_plan(episode, actor):
    """The runs of the skills by name; a shipped policy drives to where the skill can begin."""
    skills = {name: get_skill(name) for name in ("navigate", NAME, "reset_arm")}
    shipped = Learned(choose_policies("set_table", 0)["navigate"].policy)
    actors = {"navigate": shipped, NAME: actor, "reset_arm": Scripted()}
    options = ExecutorOptions(lanes=1, threads=1, settle_steps=5)
    (log,) = Executor(skills, actors, options).run([episode])
    return {done.skill: done for done in log.runs}


def test_it_is_trained_for_two_iterations_and_its_policy_runs_in_a_plan(skill, tmp_path, request, monkeypatch):
    small = replace(skill.recipe, n_envs=4, n_steps=64, batch_size=128)
    monkeypatch.setattr(SKILLS[NAME], "recipe", small)
    (path,) = train_skill(NAME, "set_table", (0,), tmp_path, 2 * 4 * 64, cores=1, split="val", episodes=2)
    policy = load_policy(path)
    assert (policy.task.observation_size, policy.task.action_size) == (27, 10)
    done = run_plan(request.getfixturevalue("episode"), Learned(policy))
    assert 0 < done[NAME].end - done[NAME].begin <= skill.limit


@pytest.mark.usefixtures("skill")
def test_it_succeeds_in_a_plan_when_the_arm_is_lifted_and_times_out_when_it_is_not(episode):
    lifted, still = run_plan(episode, Predicting(lift)), run_plan(episode, Predicting(rest))
    assert (lifted["navigate"].success, still["navigate"].success) == (True, True)
    assert (lifted[NAME].success, lifted[NAME].ending) == (True, "stopped")
    assert (still[NAME].success, still[NAME].ending) == (False, "timed out")
    assert still[NAME].end - still[NAME].begin == 60


@pytest.mark.usefixtures("skill")
def test_lifting_the_hand_earns_4_per_meter():
    env = gymnasium.make(env_id(NAME), task="set_table", split="val", episodes=1)
    before, _ = env.reset(seed=0)
    earned = 0.0
    for _ in range(10):
        after, _, _, _, info = env.step(lift([before])[0])
        earned += info["reward_terms"]["rise"]
    assert before[-1] - after[-1] > 0.05
    assert earned == pytest.approx(4.0 * (before[-1] - after[-1]))


@pytest.mark.skipif(not TOOL.exists(), reason="the tool is no part of an installed package")
@pytest.mark.usefixtures("skill")
def test_it_documents_itself():
    spec = importlib.util.spec_from_file_location("skill_tables", TOOL)
    tool = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(tool)
    page = tool.page()
    assert f"## {NAME}: `perdure/HomeRaiseHand-v0`" in page
    for row in ("| 26 `missing_height` | height to rise |", "| rise | 4 per meter of height |", "| step limit | 60 |"):
        assert row in page


def test_a_plan_with_a_skill_that_nobody_registered_is_refused(episode):
    skills = {name: get_skill(name) for name in ("navigate", "reset_arm")}
    actors = {"navigate": Scripted(), "reset_arm": Scripted()}
    with pytest.raises(HomeError, match=NAME):
        list(Executor(skills, actors, ExecutorOptions(lanes=1)).run([episode]))
