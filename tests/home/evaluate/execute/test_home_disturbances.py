"""Disturbances of `perdure home run`: what the robot perceives beside the truth, and a target that is bumped."""

from dataclasses import replace

import numpy as np
import pytest
from test_executor import Idle, planning, shorten

from perdure.errors import PerdureError
from perdure.home.evaluate.disturbances import HomeDisturbance, home_labels, parse_home_disturbances
from perdure.home.evaluate.execute import Executor, ExecutorOptions
from perdure.home.sim.vector_simulator import VectorSimulator
from perdure.home.skills import SKILLS, get_skill
from perdure.home.tasks.episodes import episode_scene, load_episodes, start_pose
from perdure.home.tasks.tasks import SkillStep, WorldFacts

PERCEPTION = HomeDisturbance("perception", 0.05)
BUMP = HomeDisturbance("bump", 0.1)


@pytest.fixture(scope="module")
def episode():
    return load_episodes("set_table", "val")[0]


def test_texts_become_disturbances_and_back():
    both = parse_home_disturbances(["perception:0.05", "bump:0.1"])
    assert both == (BUMP, PERCEPTION)
    assert home_labels(both) == "bump:0.1 perception:0.05"
    assert parse_home_disturbances(["none"]) == ()
    assert home_labels(()) == "none"


@pytest.mark.parametrize(
    ("texts", "word"),
    [
        (["bumb:0.1"], "bump"),
        (["bump"], "name:level"),
        (["bump:0.1@100"], "name:level"),
        (["bump:0"], "above 0"),
        (["perception:2"], "at most 0.5"),
        (["bump:0.1", "bump:0.2"], "twice"),
    ],
)
def test_what_is_no_disturbance_of_a_home_is_refused(texts, word):
    with pytest.raises(PerdureError, match=word):
        parse_home_disturbances(texts)


class Looks(Idle):
    """Stands still and notes what it sees of its target."""

    def __init__(self):
        self.seen = []

    def act(self, world, lanes, skill, state, progress):
        self.seen.append(np.concatenate([state.object[0], state.goal[0]]))
        return super().act(world, lanes, skill, state, progress)


def looked(episode, monkeypatch, eval_seed, *disturb):
    shorten(monkeypatch, 5, 1000)
    planning(monkeypatch, SkillStep("pick", 1), None)
    agent = Looks()
    options = ExecutorOptions(eval_seed, lanes=1, settle_steps=3, disturb=disturb)
    executor = Executor({name: get_skill(name) for name in SKILLS}, dict.fromkeys(SKILLS, agent), options)
    (log,) = executor.run([episode])
    return np.array(agent.seen), log


def test_policies_see_an_error_that_is_constant_and_the_judge_sees_none(episode, monkeypatch):
    truth, calm = looked(episode, monkeypatch, 0)
    seen, log = looked(episode, monkeypatch, 0, PERCEPTION)
    errors = seen - truth
    np.testing.assert_allclose(errors, np.tile(errors[0], (len(errors), 1)), atol=1e-12)
    assert (np.abs(errors[0]) > 1e-4).all()
    assert np.abs(errors).max() < 5 * 0.05
    np.testing.assert_array_equal(log.history.facts.object_positions, calm.history.facts.object_positions)
    np.testing.assert_array_equal(log.history.facts.goal_positions, calm.history.facts.goal_positions)
    assert log.disturbance == "perception:0.05"
    assert (log.key, log.strategy.name) != (calm.key, calm.strategy.name)

    again, _ = looked(episode, monkeypatch, 0, PERCEPTION)
    np.testing.assert_array_equal(again, seen)
    other = PERCEPTION.effect(episode, 1).perceive_facts(facts_of(episode)).object_positions[1]
    assert np.abs(other - (np.array(episode.objects[1].position) + errors[0][:3])).max() > 1e-3


def facts_of(episode):
    objects = np.array([placement.position for placement in episode.objects[: len(episode.goals)]])
    return WorldFacts(objects, episode.goal_positions, np.array(-1), {})


def test_the_planner_gets_the_same_error_as_the_policies(episode):
    effect = PERCEPTION.effect(episode, 0)
    facts = facts_of(episode)
    goal = get_skill("place").skill_goal(episode, 1, {})
    believed = effect.perceive_facts(facts)
    np.testing.assert_allclose(believed.goal_positions[1], effect.perceive_goal(goal).goal)
    spread = np.concatenate(
        [PERCEPTION.effect(episode, seed).perceive_facts(facts).object_positions for seed in range(200)]
    )
    spread = spread.reshape(200, -1) - facts.object_positions.ravel()
    assert spread.std() == pytest.approx(0.05, rel=0.1)
    assert spread.mean() == pytest.approx(0.0, abs=0.005)


def bumped(episode, at_goal, disturbance=BUMP):
    """How far each target moves in two seconds, along the floor and upward, in which the robot stands still."""
    scene = episode_scene(episode)
    world = VectorSimulator(1)
    moved = dict(enumerate(episode.goals)) if at_goal else {}
    world.reset(0, scene, start_pose(scene.apartment, episode, 0), moved=moved)
    lane = world.simulator(0)
    effect = disturbance.effect(episode, 0)
    before = lane.middles.copy()
    for _ in range(60):
        lane.step()
        effect.after_step(lane)
    way = lane.middles - before
    others = np.delete(way, effect.target, axis=0)
    return way[effect.target], others


def test_a_placed_target_is_moved_on_its_surface_and_nothing_else_is(episode):
    way, others = bumped(episode, at_goal=True)
    assert np.hypot(way[0], way[1]) == pytest.approx(0.1, abs=0.01)
    assert abs(way[2]) < 0.01
    assert np.abs(others).max() < 0.02


def test_the_control_a_target_that_is_not_at_its_goal_stays(episode):
    way, _ = bumped(episode, at_goal=False)
    assert np.linalg.norm(way) < 0.02


def test_a_bump_never_pushes_a_target_off_its_surface(episode):
    way, _ = bumped(episode, at_goal=True, disturbance=replace(BUMP, level=0.6))
    assert abs(way[2]) < 0.01
    assert np.hypot(way[0], way[1]) < 0.7
