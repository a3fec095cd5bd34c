"""Every skill still computes the recorded numbers: shipped policies and cached training runs depend on them.

`python tests/home/skills/test_recorded_skills.py` records them anew.
"""

import hashlib
import json
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hand_made import random_state

from perdure.errors import PerdureError
from perdure.home.skills import SKILLS, get_skill, learned_skills, train
from perdure.home.skills.environment import targets_of
from perdure.home.skills.place import VARIANTS, variant_options
from perdure.home.skills.train import skill_config
from perdure.home.tasks.episodes import load_episodes
from perdure.home.tasks.tasks import TASKS

RECORD = Path(__file__).with_name("recorded_skills.json")
RECORDED = json.loads(RECORD.read_text()) if RECORD.exists() else {}
RELEASES = {f"place-{name}": variant_options(name) for name in ("delta-30", *VARIANTS)}
WAYS = {name: {} for name in SKILLS} | RELEASES


def digest(values):
    """A digest of numbers to six decimals, of names and of flags."""
    parts = hashlib.sha256()
    for value in values:
        array = np.asarray(value)
        parts.update(repr((np.round(array, 6) + 0.0).tolist() if array.dtype.kind == "f" else array.tolist()).encode())
    return parts.hexdigest()[:16]


def behavior(skill):
    """All that a skill computes in 12 steps of 20 lanes of arbitrary states."""
    states = [random_state(20, seed) for seed in range(12)]
    was = skill.begin(states[0])
    for before, after in pairwise(states):
        now = skill.advance(was, after)
        total, terms = skill.reward(before, after, was, now)
        yield from (skill.observe(after, now), total, *terms, *terms.values())
        yield from (skill.success(after, now), skill.failure(after, now), skill.stop(after, now))
        actions = np.random.default_rng(0).uniform(-1.0, 1.0, (20, skill.action_size))
        yield skill.mask(skill.expand_action(actions, after), after)
        was = now


def starts(skill, task):
    """The numbers of 20 start states."""
    episodes, rng = load_episodes(task, "val").episodes, np.random.default_rng(3)
    targets = targets_of(skill, TASKS[task])
    for k in range(20):
        start = get_skill(skill).draw_start(episodes[7 * k % len(episodes)], targets[k % len(targets)], rng)
        goal = start.skill_goal
        yield from ((start.base.x, start.base.y, start.base.yaw), start.arm, start.held, sorted(start.opened))
        yield [value for _, value in sorted(start.opened.items())]
        yield [each.position for each in start.moved.values()]
        yield from ((goal.target, goal.link), goal.goal, goal.toward, goal.aim, goal.front)
        yield [] if goal.route is None else goal.route.ahead(start.base.x, start.base.y, 0)[:1]


def training(skill, task):
    """The identity of a training run: another one would train again what is cached."""
    runs = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(train, "train", lambda run, *_, **__: runs.append(run) or [])
        train.train_skill(skill, task, (0,), "nowhere")
    return hashlib.sha256(json.dumps(runs[0].identity(0), sort_keys=True).encode()).hexdigest()[:16]


def lessons():
    return [(skill, task) for skill in learned_skills() for task in TASKS if targets_of(skill, TASKS[task])]


@pytest.mark.parametrize("way", WAYS)
def test_observations_rewards_and_endings_are_as_recorded(way):
    assert digest(behavior(get_skill(way.split("-")[0], **WAYS[way]))) == RECORDED["behavior"][way]


@pytest.mark.parametrize(("skill", "task"), lessons())
def test_start_states_are_as_recorded(skill, task):
    assert digest(starts(skill, task)) == RECORDED["starts"][f"{skill} {task}"]


@pytest.mark.parametrize(("skill", "task"), lessons())
def test_training_runs_are_those_recorded(skill, task):
    assert training(skill, task) == RECORDED["training"][f"{skill} {task}"]


def test_another_reward_start_or_recipe_is_noticed(monkeypatch):
    monkeypatch.setattr("perdure.home.skills.pick.GRASP_REWARD", 1.001)
    monkeypatch.setattr("perdure.home.skills.starts.POSITION_NOISE", 0.11)
    monkeypatch.setattr(SKILLS["pick"], "recipe", replace(SKILLS["pick"].recipe, total_steps=9000))
    assert digest(behavior(get_skill("pick"))) != RECORDED["behavior"]["pick"]
    assert digest(starts("pick", "tidy_house")) != RECORDED["starts"]["pick tidy_house"]
    assert training("pick", "tidy_house") != RECORDED["training"]["pick tidy_house"]
    assert skill_config("pick", "tidy_house").total_steps == 9000
    with pytest.raises(PerdureError, match="total_steps is 1000; it must be more than one rollout"):
        skill_config("pick", "tidy_house", 1000)


if __name__ == "__main__":
    record = {
        "behavior": {name: digest(behavior(get_skill(name.split("-")[0], **how))) for name, how in WAYS.items()},
        "starts": {f"{skill} {task}": digest(starts(skill, task)) for skill, task in lessons()},
        "training": {f"{skill} {task}": training(skill, task) for skill, task in lessons()},
    }
    RECORD.write_text(json.dumps(record, indent=1) + "\n")
