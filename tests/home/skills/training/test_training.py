"""Learning a skill from end to end, small, and the score that comes out."""

from collections import Counter
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from perdure.errors import PerdureError
from perdure.home.agents.learned import Learned
from perdure.home.skills import SKILLS, get_skill, learned_skills, train
from perdure.home.skills.place import variant_name, variant_options
from perdure.home.skills.starts import plan_starts_file
from perdure.home.skills.train import evaluate_skill, skill_config, train_skill
from perdure.horizon import Constant, Countdown, Geometric
from perdure.policy import Normalizer, Policy, TaskInfo, load_policy


@pytest.fixture(scope="module")
def policy(tmp_path_factory):
    """A place policy with a time-to-go input that has learned next to nothing."""
    out = tmp_path_factory.mktemp("runs")
    usual = train.skill_config
    with pytest.MonkeyPatch.context() as patch:
        small = {"n_envs": 4, "n_steps": 32, "batch_size": 128, "n_epochs": 1, "hidden_sizes": (8,)}
        patch.setattr(
            train,
            "skill_config",
            lambda name, task, steps, **how: replace(usual(name, task, **how), total_steps=steps, **small),
        )
        steps = {"total_steps": 256, "method": "geometric"}
        (path,) = train_skill("place", "set_table", (0,), out, cores=1, **steps, split="val", episodes=2)
    assert path.parent.parent.name == "place-geometric"
    return load_policy(path)


@pytest.mark.verify
def test_a_score_counts_every_episode_once(policy, monkeypatch):
    monkeypatch.setattr(SKILLS["place"], "step_limit", 60)
    score = evaluate_skill(policy, "place", 12, lanes=4, task="set_table", episodes=2)
    assert len(score.success) == len(score.steps) == 12
    assert score.failures.total() == 12 - score.success.sum()
    assert np.all((score.steps >= 1) & (score.steps <= get_skill("place").limit))
    assert f"{score.rate:.3f} of 12" in score.summary
    again = evaluate_skill(policy, "place", 12, lanes=4, task="set_table", episodes=2)
    assert again.success.tolist() == score.success.tolist()
    assert again.steps.tolist() == score.steps.tolist()


def test_a_policy_acts_in_its_own_skill_only(policy):
    agent = Learned(policy)
    agent.begin(None, 0, get_skill("place"))
    with pytest.raises(PerdureError, match="another skill than navigate"):
        agent.begin(None, 0, get_skill("navigate"))


def test_a_policy_of_another_skill_with_the_same_sizes_is_refused():
    fridge = [get_skill(name) for name in ("open_fridge", "close_fridge")]
    sizes = {(len(skill.elements), skill.action_size) for skill in fridge}
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


def test_methods_treat_the_end_of_a_skill_as_the_thesis_does():
    """Section 3.3: T from 200 to 1000 of 1000 steps is 40 to 200 of 200; gamma 1; the horizon is the end."""
    protocols = {
        method: skill_config("place", "set_table", method=method).protocol for method in ("linear", "geometric")
    }
    horizons = {
        method: Counter(each.horizon.from_uniform(np.arange(1000) / 1000)) for method, each in protocols.items()
    }
    assert horizons["linear"] == {200: 1000}
    assert (min(horizons["geometric"]), max(horizons["geometric"]), len(horizons["geometric"])) == (40, 200, 161)
    assert {method: each.gamma for method, each in protocols.items()} == {"linear": 0.99, "geometric": 1.0}
    assert {each.end for each in protocols.values()} == {"terminated"}
    assert protocols["linear"].embedding(50, 200).tolist() == [0.75]
    assert protocols["geometric"].embedding(50, 200) == pytest.approx(np.linspace(0.99, 1.0, 10) ** 150)
    with pytest.raises(PerdureError, match="geometrical"):
        skill_config("place", "set_table", method="geometrical")


@pytest.mark.parametrize(("clock", "steps"), [(None, 150.0), (Constant(7.0), 7.0), (Countdown(60.0), 10.0)])
def test_a_time_to_go_counts_down_from_the_limit_unless_a_clock_is_named(clock, steps):
    """A policy whose action is its time-to-go input, 0.99 to the power of the steps left, 50 steps after the start."""
    task, nothing = TaskInfo("any", 3, (-1.0,), (1.0,)), np.zeros(1, np.float32)
    passing, blind = np.array([[0.0], [0.0], [0.0], [1.0]], np.float32), np.zeros((4, 1), np.float32)
    weights = {"policy.0.weight": passing, "policy.0.bias": nothing, "value.0.weight": blind, "value.0.bias": nothing}
    protocol = replace(
        skill_config("place", "set_table", method="geometric").protocol, embedding=Geometric(1, 0.99, 0.99)
    )
    policy = Policy(task, weights, "tanh", Normalizer.identity(3), protocol, Constant(1.0))
    skill = SimpleNamespace(
        limit=200, observe=lambda state, progress: np.ones((1, 3)), expand_action=lambda actions, state: actions
    )
    acted = Learned(policy, clock).act(None, np.array([0]), skill, None, SimpleNamespace(elapsed=np.array([50])))
    assert acted == pytest.approx(0.99**steps, rel=1e-6)


def test_a_policy_of_another_variant_is_refused():
    names = "perdure/HomePlace-v0,task=set_table,training=True,gentle=True"
    task = TaskInfo(names, len(get_skill("place").elements), (-1.0,) * 10, (1.0,) * 10)
    agent = Learned(SimpleNamespace(task=task))
    agent.begin(None, 0, get_skill("place", gentle=True))
    with pytest.raises(PerdureError, match="was trained with gentle=True, not False"):
        agent.begin(None, 0, get_skill("place"))
    for options, told in (({"actions": "hand"}, "actions=joints, not hand"), ({"delta": 9}, "delta=1, not 9")):
        usual = SimpleNamespace(task=replace(task, name="perdure/HomePlace-v0"))
        with pytest.raises(PerdureError, match=told):
            Learned(usual).begin(None, 0, get_skill("place", **options))


@pytest.mark.parametrize("name", ["delta-2", "delta-200", "gentle", "hand"])
def test_a_variant_has_one_name_and_one_command(name):
    assert variant_name(variant_options(name)) == name
    command = train.train_command("place", "set_table", None, variant_options(name))
    assert command == f"perdure home train place --task set_table --variant {name} --seeds {{seed}}"
    assert variant_name({"delta": 1}) is None


def test_delta_lengthens_the_horizon():
    assert skill_config("place", "set_table", delta=30).protocol.horizon.longest == 230
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
    physics = {"grasp=kept", "base_speed=1.0"}
    assert set(run.task.split(",")[1:]) - {""} == {f"task={task}", "training=True", *physics} | ({wider} - {""})
    assert wider == "" or wider not in run.command


def test_a_gentle_release_is_learned_with_less_noise():
    gentle, usual = skill_config("place", "set_table", gentle=True), skill_config("place", "set_table")
    assert replace(gentle, log_std_end=usual.log_std_end) == usual
    assert (gentle.log_std_end, usual.log_std_end) == (-3.0, -2.0)


def test_a_task_may_need_another_recipe():
    steps = {task: skill_config("place", task).total_steps for task in ("set_table", "tidy_house", "prepare_groceries")}
    assert steps == {"set_table": 4_000_000, "tidy_house": 2_000_000, "prepare_groceries": 4_000_000}


def test_a_policy_says_what_makes_it_again(policy, tmp_path):
    assert policy.provenance["command"] == (
        "perdure.home.skills.train.train_skill('place', 'set_table', (0,), OUT, total_steps=256, method='geometric', "
        "split='val', episodes=2)"
    )
    command = train.train_command("place", "set_table", 2000, {"delta": 30})
    assert (
        command.format(seed=3) == "perdure home train place --task set_table --variant delta-30 --seeds 3 --steps 2000"
    )
    command = train.train_command("place", "set_table", None, {}, "linear")
    assert command.format(seed=3) == "perdure home train place --task set_table --method linear --seeds 3"


def test_a_training_with_other_start_states_is_another_one(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    found = []
    monkeypatch.setattr("perdure.home.skills.train.train", lambda run, *_, **__: found.append(run.identity(0)))
    path = plan_starts_file("set_table")
    path.parent.mkdir(parents=True)
    for recorded in ("[]", "[ ]", "[]"):
        path.write_text(recorded)
        train_skill("place", "set_table", (0,), tmp_path)
    assert found[0] == found[2] != found[1]
