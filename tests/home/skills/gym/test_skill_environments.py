"""What every environment of every skill and task keeps."""

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode
from lanes import LESSONS, drive, make, random_actions, rows

from perdure.errors import PerdureError
from perdure.home.skills import learned_skills
from perdure.home.skills.environment import env_id, register
from perdure.home.skills.gym import HomeSkillEnv

STEPS, SEEDS = 25, (5, 6, 7)


@pytest.fixture(scope="module", params=LESSONS, ids="-".join)
def lesson(request):
    """Skill, task, and three lanes driven by actions of their own."""
    skill, task = request.param
    env = make(skill, task, lanes=3)
    actions = np.stack([random_actions(env, STEPS, seed) for seed in SEEDS], axis=1)
    return skill, task, env, actions, drive(env, SEEDS, actions)


def test_observations_are_finite_and_inside_the_space(lesson):
    *_, env, _, seen = lesson
    assert all(env.observation_space.contains(step[0]) and np.isfinite(step[0]).all() for step in seen)


def test_the_reward_is_the_sum_of_its_terms(lesson):
    *_, seen = lesson
    for _, rewards, _, _, info in (step for step in seen if len(step) > 1):
        total = sum(value for _, value in rows(info["reward_terms"]))
        np.testing.assert_allclose(rewards, total, atol=1e-12)


def test_the_same_seeds_give_the_same_course_to_the_last_bit(lesson):
    skill, task, _, actions, seen = lesson
    again = drive(make(skill, task, lanes=3), SEEDS, actions)
    for one, other in zip(seen, again, strict=True):
        assert_same(one, other)


def test_other_seeds_give_other_starts(lesson):
    *_, seen = lesson
    assert len({tuple(row) for row in seen[0][0]}) == len(SEEDS)


def test_a_lane_among_others_runs_as_it_runs_alone_to_the_last_bit(lesson):
    skill, task, _, actions, seen = lesson
    for lane, seed in enumerate(SEEDS):
        alone = drive(make(skill, task), [seed], actions[:, lane : lane + 1])
        steps = iter(step for step in seen if len(step) > 1)
        for one in (step for step in alone if len(step) > 1):
            assert_same(one, _lane(next(steps), lane))


def test_a_skill_ends_where_it_succeeds_or_fails(lesson):
    *_, seen = lesson
    for _, _, terminated, truncated, info in (step for step in seen if len(step) > 1):
        np.testing.assert_array_equal(terminated, info["success"] | (info["failure"] != "none"))
        assert not truncated.any()


def test_threads_change_nothing():
    env = make("place", "tidy_house", lanes=4, threads=1)
    actions = np.stack([random_actions(env, 10, seed) for seed in range(4)], axis=1)
    actions[..., -1] = 1.0
    for one, other in zip(
        drive(env, range(4), actions),
        drive(make("place", "tidy_house", lanes=4, threads=3), range(4), actions),
        strict=True,
    ):
        assert_same(one, other)


@pytest.mark.parametrize("skill", ["place", "navigate"])
def test_gymnasiums_checker_is_content(skill):
    check_env(HomeSkillEnv(skill=skill, split="val", episodes=2), skip_render_check=True)


def test_the_single_environment_is_a_lane_of_the_vector_to_the_last_bit():
    single, vector = HomeSkillEnv(skill="pick", split="val", episodes=2), make("pick", "tidy_house", episodes=2)
    np.testing.assert_array_equal(single.reset(seed=3)[0], vector.reset(seed=3)[0][0])
    for action in random_actions(vector, 10):
        one, many = single.step(action), vector.step(action[None])
        np.testing.assert_array_equal(one[0], many[0][0])
        assert one[1:4] == (many[1][0], many[2][0], many[3][0])
        assert one[4]["failure"] == many[4]["failure"][0]
        assert one[4]["reward_terms"]["approach"] == many[4]["reward_terms"]["approach"][0]


def test_resetting_some_lanes_leaves_the_others_as_they_are():
    env = make("pick", "tidy_house", lanes=3)
    shown, _ = env.reset(seed=0)
    renewed, _ = env.reset(options={"reset_mask": np.array([False, True, False])})
    assert [np.array_equal(a, b) for a, b in zip(shown, renewed, strict=True)] == [True, False, True]


def test_a_lane_that_ended_must_be_reset():
    env = make("place", "tidy_house", lanes=2)
    env.reset(seed=0)
    actions = np.zeros((2, 10))
    actions[1, -1] = -1.0  # lets go far from the goal
    *_, terminated, _, info = env.step(actions)
    assert (terminated.tolist(), info["failure"].tolist()) == ([False, True], ["none", "wrong drop"])
    with pytest.raises(PerdureError, match=r"lanes \[1\] have ended"):
        env.step(actions)
    env.reset(options={"reset_mask": terminated})
    env.step(0.0 * actions)


def test_the_step_limit_truncates():
    env = make("pick", "tidy_house", max_episode_steps=3)
    env.reset(seed=0)
    assert [bool(env.step(np.zeros((1, 10)))[3][0]) for _ in range(3)] == [False, False, True]


def test_a_lane_that_diverges_ends_and_is_counted_and_the_others_do_not_notice():
    courses = []
    for poisoned in (False, True):
        env = make("pick", "tidy_house", lanes=3)
        env.reset(seed=0)
        steps = []
        for number, action in enumerate(random_actions(env, 8)):
            if poisoned and number == 4:
                env.world.simulator(1).qvel[:] = np.nan
            step = env.step(np.tile(action, (3, 1)))
            if step[3].any():
                assert (number, step[3].tolist(), step[2].tolist()) == (4, [False, True, False], [False] * 3)
                assert (step[1][1], step[4]["diverged"].tolist()) == (0.0, [False, True, False])
                assert env.observation_space.contains(step[0])
                env.reset(options={"reset_mask": step[3]})
            steps.append(step)
        assert env.diverged.tolist() == [0, int(poisoned), 0]
        courses.append(steps)
    for calm, struck in zip(*courses, strict=True):
        for lane in (0, 2):
            assert_same(_lane(calm, lane), _lane(struck, lane))


class TestNames:
    def test_every_skill_is_registered_and_made_with_its_time_limit(self):
        register()  # again
        ids = {env_id(skill) for skill in learned_skills()}
        assert ids <= set(gymnasium.registry)
        assert env_id("open_drawer") == "perdure/HomeOpenDrawer-v0"
        assert gymnasium.spec("perdure/HomeNavigate-v0").max_episode_steps == 500
        env = gymnasium.make("perdure/HomePlace-v0", split="val", episodes=1, max_episode_steps=2)
        env.reset(seed=0)
        assert [env.step(np.zeros(10))[3] for _ in range(2)] == [False, True]

    def test_make_vec_gives_the_vector_over_one_world(self):
        env = gymnasium.make_vec("perdure/HomeNavigate-v0", num_envs=2, split="val", episodes=1, threads=1)
        assert env.metadata["autoreset_mode"] is AutoresetMode.DISABLED
        assert env.reset(seed=0)[0].shape == env.observation_space.shape
        assert env.single_action_space.shape == (2,)
        assert env.max_episode_steps == 500


@pytest.mark.parametrize(
    "wrong", [{"seed": [1, 2]}, {"options": {"reset_mask": np.array([True])}}, {"options": {"reset_mask": [0, 1, 0]}}]
)
def test_a_reset_that_does_not_fit_the_lanes_is_refused(wrong):
    env = make("place", "tidy_house", lanes=3)
    env.reset(seed=0)
    with pytest.raises(PerdureError):
        env.reset(**wrong)


@pytest.mark.parametrize("actions", [np.zeros((3, 9)), np.zeros(10), np.full((3, 10), np.nan)])
def test_wrong_actions_are_refused(actions):
    env = make("place", "tidy_house", lanes=3)
    env.reset(seed=0)
    with pytest.raises(PerdureError):
        env.step(actions)


def assert_same(one, other):
    """Everything a step gave, bit by bit."""
    for a, b in zip(one[:4], other[:4], strict=True):
        np.testing.assert_array_equal(a, b)
    if len(one) > 4:
        for (name, a), (twin, b) in zip(rows(one[4]), rows(other[4]), strict=True):
            assert name == twin
            np.testing.assert_array_equal(a, b, err_msg=name)


def _lane(step, lane):
    """What a step gave one lane, as a batch of one."""

    def cut(info):
        return {name: cut(v) if isinstance(v, dict) else v[lane : lane + 1] for name, v in info.items()}

    return (*[part[lane : lane + 1] for part in step[:4]], cut(step[4]))
