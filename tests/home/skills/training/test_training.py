"""Learning a skill from end to end, small, and the score that comes out."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from perdure.errors import PerdureError
from perdure.home.agents.learned import Learned
from perdure.home.skills import get_skill, learned_skills, train
from perdure.home.skills.train import evaluate_skill, skill_config, train_skill
from perdure.policy import TaskInfo, load_policy


@pytest.fixture(scope="module")
def policy(tmp_path_factory):
    """A place policy that has learned next to nothing."""
    out = tmp_path_factory.mktemp("runs")
    usual = train.skill_config
    with pytest.MonkeyPatch.context() as patch:
        small = {"n_envs": 4, "n_steps": 32, "batch_size": 128, "n_epochs": 1, "hidden_sizes": (8,)}
        patch.setattr(train, "skill_config", lambda *about, **how: replace(usual(*about, **how), **small))
        (path,) = train_skill("place", "set_table", (0,), out, cores=1, total_steps=256, split="val", episodes=2)
    return load_policy(path)


def test_a_score_counts_every_episode_once(policy):
    score = evaluate_skill(policy, "place", 12, lanes=4, task="set_table", episodes=2)
    assert len(score.success) == len(score.steps) == 12
    assert score.failures.total() == 12 - score.success.sum()
    assert np.all((score.steps >= 1) & (score.steps <= get_skill("place").limit))
    assert f"{score.rate:.3f} of 12" in score.summary()
    again = evaluate_skill(policy, "place", 12, lanes=4, task="set_table", episodes=2)
    assert again.success.tolist() == score.success.tolist()
    assert again.steps.tolist() == score.steps.tolist()


def test_a_policy_acts_in_its_own_skill_only(policy):
    agent = Learned(policy)
    agent.begin(None, 0, get_skill("place"))
    with pytest.raises(PerdureError, match="navigate has"):
        agent.begin(None, 0, get_skill("navigate"))


def test_a_policy_of_another_skill_with_the_same_sizes_is_refused():
    fridge = [get_skill(name) for name in ("open_fridge", "close_fridge")]
    sizes = {(len(skill.elements), len(skill.active_columns)) for skill in fridge}
    ((seen, moved),) = sizes  # the control: sizes tell nothing
    task = TaskInfo("perdure/HomeCloseFridge-v0", seen, (-1.0,) * moved, (1.0,) * moved)
    agent = Learned(SimpleNamespace(task=task))
    agent.begin(None, 0, get_skill("close_fridge"))
    with pytest.raises(PerdureError, match="was trained for another skill than open_fridge"):
        agent.begin(None, 0, get_skill("open_fridge"))


@pytest.mark.parametrize("skill", learned_skills())
def test_a_recipe_ends_where_the_skill_does_and_bootstraps_there(skill):
    config = skill_config(skill, "set_table")
    assert config.protocol.horizon.longest == get_skill(skill).limit
    assert config.protocol.end == "truncated"
    assert config.protocol.embedding is None


def test_delta_lengthens_the_horizon():
    assert skill_config("place", "set_table", delta=30).protocol.horizon.longest == 230
    assert skill_config("place", "set_table", delta=30, limited_to=200).protocol.horizon.longest == 200
    with pytest.raises(PerdureError, match="reset_arm"):
        skill_config("reset_arm", "set_table")


@pytest.mark.parametrize("task", ["set_table", "tidy_house", "prepare_groceries"])
def test_place_that_must_last_differs_in_nothing_but_how_long(task):
    lasting, usual = skill_config("place", task, delta=200), skill_config("place", task)
    assert lasting.protocol.horizon.longest == usual.protocol.horizon.longest + 200
    assert replace(lasting, protocol=usual.protocol) == usual


@pytest.mark.parametrize(
    ("skill", "task", "wider"),
    [("place", "set_table", ""), ("pick", "tidy_house", "clutter=True")],
)
def test_training_starts_may_be_wider_than_those_that_are_scored(skill, task, wider, monkeypatch, tmp_path):
    runs = []
    monkeypatch.setattr(train, "train", lambda run, *_, **__: runs.append(run) or [])
    train_skill(skill, task, (0,), tmp_path)
    (run,) = runs
    assert set(run.task.split(",")[1:]) - {""} == {f"task={task}", "training=True"} | ({wider} - {""})
    assert wider == "" or wider not in run.command


def test_a_task_may_need_another_recipe():
    begin = {task: skill_config("pick", task).log_std_init for task in ("set_table", "tidy_house", "prepare_groceries")}
    assert begin == {"set_table": -0.5, "tidy_house": 0.0, "prepare_groceries": 0.0}


def test_a_policy_says_what_makes_it_again(policy, tmp_path):
    assert policy.provenance["command"] == (
        "perdure.home.skills.train.train_skill('place', 'set_table', (0,), OUT, total_steps=256, split='val', "
        "episodes=2)"
    )
    command = train.train_command("place", "set_table", 2000, {"delta": 30, "limited_to": 200})
    assert command.format(seed=3) == (
        "perdure home train place --task set_table --seeds 3 --delta 30 --limited-to 200 --steps 2000"
    )
