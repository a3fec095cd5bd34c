"""The oracle: a sample of the published episodes, and the parts it is made of."""

import numpy as np
import pytest

from perdure.home.agents.learned import Scripted
from perdure.home.agents.motions import unwound
from perdure.home.agents.reach_plans import CollisionQuery
from perdure.home.agents.scripted import Oracle, plan_pick
from perdure.home.evaluate.execute import Executor, ExecutorOptions
from perdure.home.evaluate.outcomes import latched
from perdure.home.sim import pieces
from perdure.home.sim.kinematics import gripper_pose
from perdure.home.sim.pieces import Pose
from perdure.home.sim.robot import ROBOT
from perdure.home.sim.simulator import Simulator
from perdure.home.skills import get_skill
from perdure.home.tasks.episodes import episode_scene, load_episodes
from perdure.home.tasks.planning import make_plan
from perdure.home.tasks.tasks import TASKS


def solve(task, split, numbers, lanes=2):
    episodes = load_episodes(task, split)
    names = {step.skill for step in make_plan(episodes[0].home_task)}
    oracle = Oracle()
    agents = {name: Scripted() if name == "reset_arm" else oracle for name in names}
    executor = Executor({name: get_skill(name) for name in names}, agents, ExecutorOptions(lanes=lanes))
    return [all(latched(log)) for log in executor.run([episodes[k] for k in numbers])]


@pytest.mark.verify
def test_it_solves_an_episode():
    assert solve("tidy_house", "val", (18,)) == [True]


def behind_door(placement):
    return "refrigerator" in placement.receptacle


@pytest.mark.parametrize("task", TASKS)
def test_only_what_is_in_the_fridge_is_behind_a_door(task):
    for episode in load_episodes(task, "val").episodes[::5]:
        apartment = episode.apartment()
        for each in (*episode.objects, *episode.goals):
            assert apartment.is_behind_door(np.array(each.position)) == behind_door(each), (episode.name, each)


def test_an_object_behind_any_door_is_reached_from_the_front(monkeypatch):
    """The robot raises its arm some way back and drives the hand in. On an open surface it need not."""
    episode = load_episodes("tidy_house", "val")[18]
    query = CollisionQuery(Simulator(episode_scene(episode)))
    point = np.array(episode.objects[0].position)
    front = query.simulator.scene.apartment.piece(episode.objects[0].receptacle.partition("|")[0]).pose
    stand = front.to_room(np.array([1.2, 0.0]))
    base = Pose(float(stand[0]), float(stand[1]), 0.0)

    def driven_in():
        plan = plan_pick(query, point, 0, base)
        return np.hypot(plan.entry.x - plan.base.x, plan.entry.y - plan.base.y)

    assert driven_in() == 0.0
    monkeypatch.setitem(pieces.BEHIND_DOORS, episode.objects[0].receptacle.partition("|")[2], "another_door")
    assert driven_in() > 0.3


@pytest.mark.verify
@pytest.mark.parametrize("task", ["set_table", "prepare_groceries", "tidy_house"])
def test_it_solves_95_percent_of_val(task):
    done = solve(task, "val", range(100), lanes=8)
    assert np.mean(done) >= 0.95


def test_rolls_go_the_shorter_way_round():
    pose = np.array([0.3, -0.5, 3.0, 1.0, 0.1, -1.0, 0.067])
    now = np.array([0.3, -0.5, -3.0, 1.0, 0.1 + 4.0 * np.pi, -1.0, 0.067 - 2.0 * np.pi])
    same = unwound(pose, now)
    assert np.abs(same - now).max() < np.pi
    assert np.allclose(np.mod(same - pose + 1.0, 2.0 * np.pi), 1.0)
    position, axes = gripper_pose(ROBOT.torso_height, pose)
    same_position, same_axes = gripper_pose(ROBOT.torso_height, same)
    assert np.allclose(position, same_position)
    assert np.allclose(axes, same_axes)
    elbow = now + np.array([0.0, 0.0, 0.0, 7.0, 0.0, 0.0, 0.0])
    assert unwound(pose, elbow)[3] == pose[3]
