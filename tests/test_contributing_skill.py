"""A skill is one class: this one is trained, runs in a plan and documents itself. Copy it (CONTRIBUTING.md)."""

import importlib.util
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import gymnasium
import numpy as np
import pytest

from perdure.errors import PerdureError
from perdure.home.agents.learned import Learned, Predicting, Scripted
from perdure.home.evaluate.execute import Executor, ExecutorOptions
from perdure.home.evaluate.policies import choose_policies
from perdure.home.sim.arrays import BoolArray, FloatArray
from perdure.home.sim.robot import ROBOT
from perdure.home.sim.sensors import PrivilegedState
from perdure.home.skills import SKILLS, get_skill
from perdure.home.skills.environment import env_id, register
from perdure.home.skills.skill import PROPRIOCEPTION, Element, ObservationBlock, Recipe, Skill, SkillProgress
from perdure.home.skills.train import train_skill
from perdure.home.tasks.episodes import load_episodes
from perdure.home.tasks.tasks import TASKS, with_resets
from perdure.policy import load_policy

NAME = "raise_hand"
TOOL = Path(__file__).parents[1] / "tools" / "skill_tables.py"
ELBOW_FLEX = 5


def missing_height(state: PrivilegedState) -> FloatArray:
    """Return how far the gripper point is below 0.2 m above its rest position in [m]. Shape (n,)."""
    return np.maximum(ROBOT.rest_position[2] + 0.2 - state.gripper_in_base[:, 2], 0.0)


@dataclass(frozen=True)
class RaiseHand(Skill):
    """Lift the hand; begins within 2 m of the target object, like pick."""

    name = NAME
    step_limit = 60
    observation = (
        PROPRIOCEPTION,
        ObservationBlock(
            (Element("missing_height", "height to rise", "m", 0.0),), lambda state, _: [missing_height(state)]
        ),
    )
    rewards: ClassVar = {"rise": "4 per meter of height"}
    success_text = "the gripper point is 0.2 m above rest"
    recipe = Recipe(total_steps=200_000)

    def reward_terms(
        self, before: PrivilegedState, after: PrivilegedState, was: SkillProgress, now: SkillProgress
    ) -> Mapping[str, FloatArray]:
        """See `Skill.reward_terms`."""
        return {"rise": 4.0 * (missing_height(before) - missing_height(after))}

    def success(self, state: PrivilegedState, progress: SkillProgress) -> BoolArray:
        """See `success_text`."""
        return np.asarray(missing_height(state) == 0.0)


@pytest.fixture
def skill(monkeypatch):
    """The skill, registered by one line."""
    monkeypatch.setitem(SKILLS, NAME, RaiseHand)
    register()
    yield get_skill(NAME)
    del gymnasium.registry[env_id(NAME)]


@pytest.fixture
def episode(monkeypatch):
    """An episode of a task whose plan uses the skill."""
    plan = with_resets(("navigate", 0), (NAME, 0))
    monkeypatch.setitem(TASKS, "wave", replace(TASKS["set_table"], name="wave", sequence=plan))
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


@pytest.mark.verify
def test_it_is_trained_for_two_iterations_and_its_policy_runs_in_a_plan(skill, tmp_path, request, monkeypatch):
    small = replace(skill.recipe, settings={"n_envs": 4, "n_steps": 64, "batch_size": 128, "n_epochs": 1})
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
    assert "`perdure/HomeRaiseHand-v0`: 27 numbers observed, at most 60 steps." in page
    assert "Success: the gripper point is 0.2 m above rest." in page
    for row in ("|26 `missing_height`|height to rise|m|0|inf|", "|rise|4 per meter of height|"):
        assert row in page


def test_a_plan_with_a_skill_that_nobody_registered_is_refused(episode):
    skills = {name: get_skill(name) for name in ("navigate", "reset_arm")}
    actors = {"navigate": Scripted(), "reset_arm": Scripted()}
    with pytest.raises(PerdureError, match=NAME):
        list(Executor(skills, actors, ExecutorOptions(lanes=1)).run([episode]))
