"""Where skills begin, against the benchmark's own numbers."""

from contextlib import closing

import numpy as np
import pytest
from lanes import LESSONS, make

from perdure.home.sim.kinematics import gripper_pose
from perdure.home.sim.occupancy import free_space
from perdure.home.sim.robot import ROBOT
from perdure.home.sim.scene import LEVERS, SceneOptions
from perdure.home.sim.vector_simulator import VectorSimulator
from perdure.home.skills import get_skill, learned_skills
from perdure.home.skills.starts import begin, touching
from perdure.home.tasks.episodes import episode_scene, load_episodes
from perdure.home.tasks.planning import make_plan

DRAWS = 40


def draws(skill, task, target=None, count=DRAWS):
    """Draws in several episodes: (episode, target, start)."""
    episodes = load_episodes(task, "val").episodes
    targets = sorted({step.target for step in make_plan(task) if step.skill == skill})
    rng = np.random.default_rng(0)
    for k in range(count):
        chosen = targets[k % len(targets)] if target is None else target
        episode = episodes[7 * k % len(episodes)]
        yield episode, chosen, get_skill(skill).draw_start(episode, chosen, rng)


def heading_error(base, point):
    facing = np.arctan2(point[1] - base.y, point[0] - base.x)
    return float(np.mod(base.yaw - facing + np.pi, 2.0 * np.pi) - np.pi)


@pytest.mark.parametrize(("skill", "task"), LESSONS)
def test_a_lane_begins_with_the_robot_free_and_the_same_draws_give_the_same_start(skill, task):
    episode = load_episodes(task, "val")[3]
    target = next(step.target for step in make_plan(task) if step.skill == skill)
    scene = episode_scene(episode, SceneOptions(physics_hz=120, clutter=False, targets=(target,)))
    world = VectorSimulator(2, 1)
    for seed in range(5):
        one, two = (
            begin(world, lane, scene, get_skill(skill).draw_start, episode, target, np.random.default_rng(seed))
            for lane in (0, 1)
        )
        assert touching(world.simulator(0)) <= 0.001
        assert one.base == two.base
        np.testing.assert_array_equal(world.simulator(0).qpos, world.simulator(1).qpos)
        assert world.simulator(0).held == one.held


def begun_lane(skill, episode, target):
    """A world with one lane at a start state of a skill."""
    scene = episode_scene(episode, SceneOptions(clutter=False, targets=(target,)))
    world = VectorSimulator(1, 1)
    begin(world, 0, scene, get_skill(skill).draw_start, episode, target, np.random.default_rng(0))
    return world


@pytest.mark.parametrize(("skill", "task"), LESSONS)
def test_the_first_observation_has_the_object_where_mujoco_has_it(skill, task):
    for target in {step.target for step in make_plan(task) if step.skill == skill}:
        world = begun_lane(skill, load_episodes(task, "val")[3], target)
        np.testing.assert_allclose(world.sense().object[0], world.simulator(0).data.body("object_0").xpos, atol=1e-9)


@pytest.mark.parametrize(("skill", "target"), [("pick", 0), ("close_drawer", 0), ("close_fridge", 1)])
def test_a_lane_that_diverges_is_at_its_start_again_with_what_had_moved(skill, target):
    world = begun_lane(skill, load_episodes("set_table", "val")[3], target)
    start = world.simulator(0).qpos.copy()
    world.simulator(0).qvel[:] = np.nan
    world.step(np.zeros((1, ROBOT.action_size)))
    assert world.sense().diverged[0]
    np.testing.assert_array_equal(world.simulator(0).qpos, start)


@pytest.mark.parametrize("skill", ["pick", "place"])
@pytest.mark.parametrize("task", ["tidy_house", "prepare_groceries", "set_table"])
def test_pick_and_place_begin_within_2_m_of_what_they_are_about_and_face_it(skill, task):
    distances, turns = [], []
    for episode, target, start in draws(skill, task):
        point = (episode.objects if skill == "pick" else episode.goals)[target].position
        distances.append(np.hypot(start.base.x - point[0], start.base.y - point[1]))
        turns.append(heading_error(start.base, point))
        assert start.held == (0 if skill == "place" else -1)
    assert max(distances) <= 2.0 + 0.2 * np.sqrt(2.0)
    assert np.ptp(distances) > 0.8
    assert max(np.abs(turns)) <= 0.5
    assert 0.15 < np.std(turns) < 0.35  # 0.25, cut at 0.5, 40 draws


@pytest.mark.parametrize(("skill", "task"), LESSONS)
def test_the_gripper_begins_within_5_cm_per_axis_of_rest(skill, task):
    away = (
        np.array([gripper_pose(ROBOT.torso_height, start.arm)[0] for _, _, start in draws(skill, task)])
        - ROBOT.rest_position
    )
    assert np.abs(away).max() < 0.052
    assert (away.std(axis=0) > 0.015).all()


def test_a_pick_from_the_fridge_or_a_drawer_finds_it_open():
    fridge = [start.opened["top_door"] for *_, start in draws("pick", "set_table", target=1)]
    drawer = [start.opened[episode.container(0)] for episode, _, start in draws("pick", "set_table", target=0)]
    for values, (low, high) in ((fridge, (1.5, 2.35)), (drawer, (0.4, 0.5))):
        assert low <= min(values) < max(values) <= high
        assert np.ptp(values) > 0.8 * (high - low)


def test_what_lies_in_a_drawer_has_moved_out_with_it():
    for episode, _, start in draws("pick", "set_table", target=0, count=10):
        link, apartment = episode.container(0), episode.apartment()
        way = np.subtract(start.moved[0].position, episode.objects[0].position)
        front = apartment.handle_to_room(link, 1.0) - apartment.handle_to_room(link, 0.0)
        np.testing.assert_allclose(way, start.opened[link] * front, atol=1e-9)


def test_what_lies_in_an_open_drawer_stays_where_it_is():
    episode = load_episodes("set_table", "val")[0]
    scene = episode_scene(episode, SceneOptions(physics_hz=120, clutter=False, targets=(0,)))
    world = VectorSimulator(1)
    start = begin(world, 0, scene, get_skill("pick").draw_start, episode, 0, np.random.default_rng(0))
    before, _ = world.simulator(0).objects(1)
    for _ in range(30):
        world.step(np.zeros((1, ROBOT.action_size)))
    after, speed = world.simulator(0).objects(1)
    np.testing.assert_allclose(before[0, :3], start.moved[0].position)
    assert np.linalg.norm(after[0, :3] - before[0, :3]) < 0.01
    assert np.linalg.norm(speed) < 0.01


def test_a_place_into_the_fridge_finds_it_open_and_others_leave_it_as_it_is():
    for episode, target, start in draws("place", "prepare_groceries"):
        inside = episode.apartment().container(episode.goals[target].receptacle) == "top_door"
        assert inside == (target == 2)
        assert list(start.opened) == (["top_door"] if inside else [])


@pytest.mark.parametrize(
    ("skill", "x", "y"),
    [("open_drawer", (0.3, 1.5), 0.6), ("close_drawer", (0.3, 1.0), 0.6)],
)
def test_drawers_are_opened_and_closed_from_in_front_of_the_handle(skill, x, y):
    for episode, target, start in draws(skill, "set_table"):
        link, apartment = episode.container(target), episode.apartment()
        point = apartment.handle_to_room(link, start.opened.get(link, 0.0))
        turned = apartment.piece_of(link).pose.yaw
        away = np.array([start.base.x - point[0], start.base.y - point[1]])
        ahead, aside = away @ (np.cos(turned), np.sin(turned)), away @ (-np.sin(turned), np.cos(turned))
        assert x[0] - 0.2 <= ahead <= x[1] + 0.2
        assert abs(aside) <= y + 0.2
        assert abs(heading_error(start.base, point)) <= 0.5
        np.testing.assert_allclose(start.skill_goal.aim, point)


def test_the_fridge_is_opened_and_closed_from_in_front_of_it():
    for skill in ("open_fridge", "close_fridge"):
        for episode, _, start in draws(skill, "set_table"):
            fridge = episode.apartment().piece_of("top_door").pose
            ahead, aside = fridge.to_local(np.array([start.base.x, start.base.y]))
            assert 0.8 - 0.2 <= ahead <= 2.0 + 0.2
            assert abs(aside) <= 1.0 + 0.2


def test_doors_and_drawers_begin_where_the_benchmark_has_them():
    opened = {skill: [s.opened for *_, s in draws(skill, "set_table")] for skill in learned_skills() if "_" in skill}
    assert all(not each for each in opened["open_fridge"])
    others = np.array([list(each.values()) for each in opened["open_drawer"]])
    assert others.shape == (DRAWS, 6)
    assert 0.0 <= others.min() < 0.01 < 0.09 < others.max() <= 0.1
    assert all(0.4 <= next(iter(each.values())) <= 0.5 for each in opened["close_drawer"])
    assert all(np.pi / 2 - 0.15 <= each["top_door"] <= 2.356 for each in opened["close_fridge"])


def test_what_was_placed_lies_at_its_goal_when_its_container_is_closed():
    for episode, target, start in draws("close_drawer", "set_table", count=4):
        assert start.moved[0] == episode.goals[target]


def test_navigation_begins_anywhere_and_carries_what_is_placed_next():
    seen = set()
    for episode, _, start in draws("navigate", "set_table", count=60):
        seen.add(start.skill_goal.toward)
        assert start.held == (0 if start.skill_goal.toward == "place" else -1)
        space = free_space(episode.apartment(), start.opened)
        assert space.is_free(np.array([[start.base.x, start.base.y]]))[0]
        assert np.isfinite(start.skill_goal.route.ahead(start.base.x, start.base.y, 0)[0])
    assert seen == {"open_drawer", "place", "close_drawer", "open_fridge", "pick", "close_fridge"}


def test_training_draws_the_rolling_resistance_of_each_episode_and_the_same_draws_give_it_again():
    drawn = []
    for _ in range(2):
        with closing(make("place", "set_table", lanes=24, targets=(1,), training=True)) as env:
            env.reset(seed=5)
            models = [env.world.simulator(lane).model for lane in range(24)]
            frictions = [each.geom_friction[each.geom_condim == 6, 2].tolist() for each in models]
            drawn.append([each[0] if each else 0.0 for each in frictions])
    assert drawn[0] == drawn[1]
    assert set(drawn[0]) == set(LEVERS)
