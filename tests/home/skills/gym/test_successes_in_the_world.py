"""Skills done by simple scripts in the simulated world: success comes at the end and not before."""

import numpy as np
import pytest
from lanes import begin_at, make
from skill_scripts import action, never, start_within_reach, steps_until, to_rest

from perdure.home.sim.pieces import Pose
from perdure.home.sim.sensors import SkillGoal
from perdure.home.skills import Aim, region
from perdure.home.skills.starts import Start, handle, link_number


def prepared(skill, task, point_of, skill_goal_of, **options):
    """An environment and the skill_goal's point, its only lane beginning within reach of it."""
    start = {
        name: options.pop(name) for name in ("held", "opened", "moved", "above", "back", "headings") if name in options
    }
    env = make(skill, task, episodes=1, **options)
    episode, target = env.sampler.episodes[0], env.options.chosen_targets[0]
    point = point_of(episode, target)
    begin_at(env, start_within_reach(env.sampler.scene(0, target), point, skill_goal_of(episode, target), **start))
    env.reset(seed=0)
    return env


def carry_skill_goal(episode, target):
    return SkillGoal(0, episode.goals[target].position, toward="place", aim=episode.goals[target].position)


def of_object(episode, target):
    return episode.objects[target].position


def of_goal(episode, target):
    return episode.goals[target].position


def test_an_object_is_picked_by_grasping_it_and_bringing_the_gripper_to_rest():
    env = prepared("pick", "tidy_house", of_object, carry_skill_goal)
    *_, terminated, _, info = env.step(action(grip=1.0))
    assert env.state.held.tolist() == [0]
    assert info["reward_terms"]["grasp"].tolist() == [1.0]
    assert not terminated[0]
    _, rewards, _, _, info = steps_until(env, to_rest, never)
    assert info["success"][0]
    assert rewards[0] > 2.4


def test_nothing_is_picked_by_grasping_16_cm_above_it():
    env = prepared("pick", "tidy_house", of_object, carry_skill_goal, above=0.16)
    env.step(action(grip=1.0))
    assert env.state.held.tolist() == [-1]


@pytest.mark.parametrize("delta", [1, 90])
def test_an_object_let_go_above_its_goal_is_placed_when_the_gripper_is_back_and_delta_steps_have_passed(delta):
    env = prepared("place", "tidy_house", of_goal, carry_skill_goal, delta=delta, held=0, above=0.12, targets=0)
    info = env.step(action(grip=-1.0))[-1]
    assert info["reward_terms"]["release"].tolist() == [1.0]
    assert not info["success"][0]
    _, _, _, _, info = steps_until(env, to_rest, never)
    assert info["success"][0]
    assert env.progress.lasting[0] >= delta
    assert env.progress.lasting[0] == delta or delta == 1  # after 90 steps the arm has long been at rest
    assert env.state.object_to_goal[0] <= 0.15


def test_an_object_let_go_above_its_goal_region_is_a_wrong_drop():
    env = prepared("place", "tidy_house", of_goal, carry_skill_goal, held=0, above=0.26, targets=0)
    assert 0.15 < env.state.object_to_goal[0] < 0.26  # it is before the fingers
    *_, terminated, _, info = env.step(action(grip=-1.0))
    assert terminated[0]
    assert info["failure"].tolist() == ["wrong drop"]


@pytest.mark.parametrize(
    ("skill", "q", "pull", "on"),
    [("open_drawer", 0.0, -0.2, 0), ("open_drawer", 0.0, -0.2, 60), ("close_drawer", 0.45, 0.2, 0)],
    ids=["open", "open to the stop", "close"],
)
def test_a_drawer_is_pulled_open_and_pushed_closed_by_its_handle(skill, q, pull, on):
    def skill_goal(episode, target):
        link = episode.container(target)
        point = handle(episode.apartment(), link, q)
        return SkillGoal(0, link=link_number(episode.apartment(), link), toward=skill, aim=point)

    def point(episode, target):
        return skill_goal(episode, target).aim

    probe = make(skill, "set_table", episodes=1).sampler.episodes[0]
    link = probe.container(0)
    facing = probe.apartment().piece_of(link).pose.yaw + np.pi
    env = prepared(skill, "set_table", point, skill_goal, above=0.06, back=0.1, opened={link: q}, headings=[facing])
    info = env.step(action(grip=1.0))[-1]
    assert info["reward_terms"]["grasp"].tolist() == [1.0]
    steps_until(
        env, lambda env: action(forward=pull), lambda env: bool(env.skill.is_accepted(env.state.link_position)[0])
    )
    for _ in range(on):
        env.step(action(forward=pull))
    info = env.step(action(grip=-1.0))[-1]
    assert info["reward_terms"]["release"].tolist() == [1.0]
    assert not info["success"][0]
    info = steps_until(env, lambda env: action(forward=-0.1) + to_rest(env), never)[-1]
    assert info["success"][0], info["failure"]


def test_a_robot_that_stands_right_has_arrived_when_it_has_stood_long_enough_and_one_turned_away_never_has():
    env = make("navigate", "tidy_house", episodes=1)
    episode = env.sampler.episodes[0]
    point = episode.objects[0].position
    space, cells = region(episode.apartment(), {}, Aim(point))
    x, y = space.centers[cells[0]]
    yaw = float(np.arctan2(point[1] - y, point[0] - x))
    skill_goal = SkillGoal(0, point, toward="pick", aim=point, route=space.distances(cells))
    for off, arrives in ((0.2, True), (0.3, False)):
        arm = start_within_reach(env.sampler.scene(0, 0), point, skill_goal).arm
        begin_at(env, Start(Pose(float(x), float(y), yaw + off), arm, skill_goal))
        env.reset(seed=0)
        _, _, terminated, _, info = env.step(np.zeros((1, 2)))
        assert (terminated[0], info["success"][0], info["failure"][0]) == (arrives, arrives, "none")
