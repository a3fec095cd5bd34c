"""The vector wrappers: step patterns written out by hand, parity with the single wrappers, and what they refuse."""

from functools import partial

import envpool
import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AsyncVectorEnv, AutoresetMode, SyncVectorEnv
from gymnasium.wrappers.vector import NormalizeObservation, RecordEpisodeStatistics
from stumbling import Stumbling

from perdure.errors import PerdureError
from perdure.horizon import Constant, Countdown, Fixed, Geometric, Infinite, LaneClocks, Linear, Uniform
from perdure.wrappers import HorizonLimit, TimeToGoObservation, VectorHorizonLimit, VectorTimeToGoObservation

COIN = Geometric(1, low=0.5, high=0.5)  # phi = 2^-(time-to-go)
NEXT_STEP, SAME_STEP, DISABLED = AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP, AutoresetMode.DISABLED


def worlds(mode, *options, copy=True):
    """One Stumbling world for each dictionary of options."""
    return SyncVectorEnv([partial(Stumbling, **each) for each in options], autoreset_mode=mode, copy=copy)


def actions(env):
    return np.zeros(env.action_space.shape, env.action_space.dtype)


def rows_of(env, count):
    """Per step: reward, terminated, truncated and the steps the world shows, each a list over lanes."""
    rows = []
    for _ in range(count):
        observations, rewards, terminated, truncated, _ = env.step(actions(env))
        rows.append(
            (
                rewards.tolist(),
                terminated.astype(int).tolist(),
                truncated.astype(int).tolist(),
                observations[:, 1].tolist(),
            )
        )
    return rows


def to_go_of(env, count):
    """-log2 phi after the reset and after each of `count` steps, each a list over lanes."""
    seen = [env.reset(seed=0)[0], *(env.step(actions(env))[0] for _ in range(count))]
    return [(-np.log2(observations[:, -1])).tolist() for observations in seen]


def same(one, two):
    """Equality of nested dictionaries, tuples and arrays, their types included."""
    if isinstance(one, dict):
        return set(one) == set(two) and all(same(one[key], two[key]) for key in one)
    if isinstance(one, tuple) or (isinstance(one, np.ndarray) and one.dtype == object):
        return len(one) == len(two) and all(same(a, b) for a, b in zip(one, two, strict=True))
    return type(one) is type(two) and np.array_equal(one, two)


def test_next_step_mode_resets_on_the_step_after_the_horizon():
    # Lane 0 has nothing but its horizon of 3. Lane 1 falls on step 2 first, then has its horizon too.
    env = VectorHorizonLimit(worlds(NEXT_STEP, {}, {"falls": [2]}), Fixed(3), "terminated")
    env.reset(seed=0)
    assert rows_of(env, 7) == [
        ([1, 1], [0, 0], [0, 0], [1, 1]),
        ([2, 2], [0, 1], [0, 0], [2, 2]),
        ([3, 0], [1, 0], [0, 0], [3, 0]),  # lane 1 is reset: reward 0, no flag, 0 steps
        ([0, 1], [0, 0], [0, 0], [0, 1]),  # lane 0 is reset
        ([1, 2], [0, 0], [0, 0], [1, 2]),
        ([2, 3], [0, 1], [0, 0], [2, 3]),
        ([3, 0], [1, 0], [0, 0], [3, 0]),
    ]


def test_truncated_ends_differ_from_terminated_ones_in_the_flag_only():
    env = VectorHorizonLimit(worlds(NEXT_STEP, {}, {"falls": [2]}), Fixed(3), "truncated")
    env.reset(seed=0)
    rows = rows_of(env, 7)
    assert [row[1] for row in rows] == [[0, 0], [0, 1], [0, 0], [0, 0], [0, 0], [0, 0], [0, 0]]
    assert [row[2] for row in rows] == [[0, 0], [0, 0], [1, 0], [0, 0], [0, 0], [0, 1], [1, 0]]
    assert [row[3] for row in rows] == [[1, 1], [2, 2], [3, 0], [0, 1], [1, 2], [2, 3], [3, 0]]


def test_a_fall_on_the_unseen_step_below_is_not_shown():
    # The world falls on step 4; the horizon is 3, and in NEXT_STEP mode the world below takes that fourth step.
    env = VectorHorizonLimit(worlds(NEXT_STEP, {"falls": [4, 4]}), Fixed(3), "truncated")
    env.reset(seed=0)
    assert rows_of(env, 9)[3:] == [
        ([0], [0], [0], [0]),
        ([1], [0], [0], [1]),
        ([2], [0], [0], [2]),
        ([3], [0], [1], [3]),
        ([0], [0], [0], [0]),
        ([1], [0], [0], [1]),
    ]


def test_a_fall_on_the_last_step_stays_terminated():
    for mode in (NEXT_STEP, SAME_STEP):
        env = VectorHorizonLimit(worlds(mode, {"falls": [3]}), Fixed(3), "truncated")
        env.reset(seed=0)
        assert [row[1:3] for row in rows_of(env, 3)] == [([0], [0]), ([0], [0]), ([1], [0])]


def test_same_step_mode_resets_at_the_horizon_and_keeps_the_last_observation():
    env = VectorHorizonLimit(worlds(SAME_STEP, {}, {"falls": [2]}), Fixed(3), "truncated")
    env.reset(seed=0)
    env.step(actions(env))
    observations, rewards, terminated, truncated, infos = env.step(actions(env))
    assert (observations[:, 1].tolist(), rewards.tolist()) == ([2, 0], [2, 2])
    assert (terminated.tolist(), truncated.tolist()) == ([False, True], [False, False])
    assert (infos["_final_obs"].tolist(), infos["final_obs"][1][1]) == ([False, True], 2)
    observations, rewards, terminated, truncated, infos = env.step(actions(env))
    assert (observations[:, 1].tolist(), rewards.tolist()) == ([0, 1], [3, 1])
    assert (terminated.tolist(), truncated.tolist()) == ([False, False], [True, False])
    assert (infos["_final_obs"].tolist(), infos["final_obs"][0][1]) == ([True, False], 3)
    assert infos["final_info"]["steps"].tolist() == [3, 0]
    assert infos["_steps"].tolist() == [False, True]  # the step's own info of lane 0 is final_info now
    assert infos["_start"].tolist() == [True, False]  # what its reset said


def test_disabled_mode_leaves_the_reset_to_the_user():
    env = VectorHorizonLimit(worlds(DISABLED, {}, {"falls": [2]}), Fixed(3), "truncated")
    env.reset(seed=0)
    rows = rows_of(env, 2)
    env.reset(options={"reset_mask": np.array([False, True])})
    rows += rows_of(env, 1)
    with pytest.raises(PerdureError, match=r"lanes \[0\] have ended: reset them before the next step"):
        env.step(actions(env))
    env.reset(options={"reset_mask": np.array([True, False])})
    rows += rows_of(env, 2)
    assert [row[1:] for row in rows] == [
        ([0, 0], [0, 0], [1, 1]),
        ([0, 1], [0, 0], [2, 2]),
        ([0, 0], [1, 0], [3, 1]),
        ([0, 0], [0, 0], [1, 2]),
        ([0, 0], [0, 1], [2, 3]),
    ]


def test_phi_in_next_step_mode_is_that_of_the_observation_shown():
    limit = VectorHorizonLimit(worlds(NEXT_STEP, {}, {"falls": [2]}), Fixed(3), "terminated")
    assert to_go_of(VectorTimeToGoObservation(limit, COIN), 5) == [[3, 3], [2, 2], [1, 1], [0, 3], [3, 2], [2, 1]]


def test_phi_in_same_step_mode_is_appended_to_the_last_observation_too():
    limit = VectorHorizonLimit(worlds(SAME_STEP, {}, {"falls": [2]}), Fixed(3), "terminated")
    env = VectorTimeToGoObservation(limit, COIN)
    assert to_go_of(env, 2) == [[3, 3], [2, 2], [1, 3]]
    observations, *_, infos = env.step(actions(env))
    assert (-np.log2(observations[:, -1])).tolist() == [3, 2]
    assert infos["final_obs"][0][1:].tolist() == [3, 1]  # 3 steps, phi(3, 3) = 1
    assert infos["final_obs"][1] is None


def test_the_last_observation_carries_the_horizon_of_its_own_episode():
    limit = VectorHorizonLimit(worlds(SAME_STEP, {"falls": [2] * 50}), Uniform(3, 60), "terminated")
    env = VectorTimeToGoObservation(limit, COIN)
    env.reset(seed=1)
    seen = []
    for _ in range(20):
        before = limit.horizons[0]
        env.step(actions(env))
        *_, infos = env.step(actions(env))
        assert -np.log2(infos["final_obs"][0][-1]) == before - 2
        seen.append((before, limit.horizons[0]))
    assert any(old != new for old, new in seen)


def test_phi_in_disabled_mode_follows_the_users_resets():
    limit = VectorHorizonLimit(worlds(DISABLED, {}, {"falls": [2]}), Fixed(3), "terminated")
    env = VectorTimeToGoObservation(limit, COIN)
    assert to_go_of(env, 2) == [[3, 3], [2, 2], [1, 1]]
    observations, _ = env.reset(options={"reset_mask": np.array([False, True])})
    assert (-np.log2(observations[:, -1])).tolist() == [1, 3]


def test_a_clock_is_told_in_deployment_and_lanes_may_have_one_each():
    falling = worlds(NEXT_STEP, {}, {"falls": [2]})
    env = VectorTimeToGoObservation(falling, COIN, clock=LaneClocks([Constant(7), Countdown(5)]))
    assert to_go_of(env, 4) == [[7, 5], [7, 4], [7, 3], [7, 5], [7, 4]]
    env = VectorTimeToGoObservation(worlds(SAME_STEP, {}, {"falls": [2]}), COIN, clock=Countdown(5))
    assert to_go_of(env, 4) == [[5, 5], [4, 4], [3, 5], [2, 4], [1, 3]]


@pytest.mark.parametrize("mode", [NEXT_STEP, SAME_STEP, DISABLED], ids=lambda mode: mode.value)
@pytest.mark.parametrize("end", ["terminated", "truncated"])
@pytest.mark.parametrize("as_dict", [False, True])
@pytest.mark.parametrize("distribution", [Uniform(1, 9), Fixed(5)], ids=str)  # with 5, a fall meets the horizon
def test_wrapping_above_equals_wrapping_each_world_inside(mode, end, as_dict, distribution):
    falls = [{"falls": [5, 5, 5, 2], "cuts": [50, 3], "as_dict": as_dict}, {"as_dict": as_dict}, {"as_dict": as_dict}]
    embedding = Geometric(3)

    def inside(options):
        return TimeToGoObservation(HorizonLimit(Stumbling(**options), distribution, end), embedding, dict=as_dict)

    within = SyncVectorEnv([partial(inside, each) for each in falls], autoreset_mode=mode)
    above = VectorTimeToGoObservation(
        VectorHorizonLimit(worlds(mode, *falls), distribution, end), embedding, dict=as_dict
    )
    assert within.single_observation_space == above.single_observation_space
    assert within.observation_space == above.observation_space
    assert not same(within.reset(seed=[4, None, 9]), above.reset(seed=[4, None, 9]))  # lane 1 is unseeded
    assert same(within.reset(seed=11), above.reset(seed=11))
    ends = 0
    for _ in range(150):
        one, two = within.step(actions(within)), above.step(actions(above))
        assert same(one, two)
        assert above.observation_space.contains(two[0])
        done = two[2] | two[3]
        ends += done.sum()
        if mode is DISABLED and done.any():
            assert same(
                within.reset(options={"reset_mask": done.copy()})[0],
                above.reset(options={"reset_mask": done.copy()})[0],
            )
    assert ends > 50


def test_observations_that_share_memory_with_the_world_survive_the_reset():
    env = VectorHorizonLimit(worlds(SAME_STEP, {}, {}, copy=False), Fixed(2), "truncated")
    env.reset(seed=0)
    env.step(actions(env))
    observations, *_, infos = env.step(actions(env))
    assert observations[:, 1].tolist() == [0, 0]
    assert [last[1] for last in infos["final_obs"]] == [2, 2]


def test_each_lane_draws_the_horizons_of_its_own_seed():
    distribution = Uniform(1, 100_000)
    env = VectorHorizonLimit(worlds(NEXT_STEP, {}, {}, {}), distribution, "terminated")
    alone = HorizonLimit(Stumbling(), distribution, "terminated")
    env.reset(seed=[5, 6, 5])
    for lane, seed in enumerate([5, 6, 5]):
        alone.reset(seed=seed)
        assert env.horizons[lane] == alone.horizon
    before = env.horizons.copy()
    env.reset(seed=[8, 8, 8], options={"reset_mask": np.array([False, True, False])})
    alone.reset(seed=8)
    assert env.horizons.tolist() == [before[0], alone.horizon, before[2]]
    # A lane without a seed goes on with its own stream: its second draw, not one of a new stream.
    env.reset(seed=[5, 6, 5])
    env.reset(seed=[4, None, 4])
    alone.reset(seed=6)
    alone.reset()
    assert env.horizons[1] == alone.horizon


def test_statistics_and_a_normalizer_may_stand_above_the_limit_and_below_phi():
    limit = VectorHorizonLimit(worlds(NEXT_STEP, {}, {}), Fixed(3), "terminated")
    env = VectorTimeToGoObservation(NormalizeObservation(RecordEpisodeStatistics(limit)), COIN)
    assert to_go_of(env, 3) == [[3, 3], [2, 2], [1, 1], [0, 0]]
    env.step(actions(env))
    statistics = env.env.env
    assert list(statistics.length_queue) == [3, 3]
    assert list(statistics.return_queue) == [6.0, 6.0]


@pytest.mark.parametrize("clock", [None, Constant(3)])
def test_the_users_options_are_left_as_they_were(clock):
    world = worlds(DISABLED, {}, {}) if clock else VectorHorizonLimit(worlds(DISABLED, {}, {}), Fixed(3), "terminated")
    env = VectorTimeToGoObservation(world, COIN, clock=clock)
    env.reset(seed=0)
    options = {"reset_mask": np.array([True, False])}
    env.reset(options=options)
    assert options["reset_mask"].tolist() == [True, False]


def test_worlds_in_processes_are_limited_too():
    env = VectorHorizonLimit(
        AsyncVectorEnv([Stumbling, partial(Stumbling, falls=[2])], context="spawn"), Fixed(3), "truncated"
    )
    env.reset(seed=0)
    try:
        assert [row[1:] for row in rows_of(env, 5)] == [
            ([0, 0], [0, 0], [1, 1]),
            ([0, 1], [0, 0], [2, 2]),
            ([0, 0], [1, 0], [3, 0]),
            ([0, 0], [0, 0], [0, 1]),
            ([0, 0], [0, 0], [1, 2]),
        ]
    finally:
        env.close()


def hoppers():
    return envpool.make("Hopper-v4", env_type="gymnasium", num_envs=3, seed=5, num_threads=1)


def test_envpool_is_limited_lane_by_lane_and_other_lanes_do_not_notice():
    bare, env = hoppers(), VectorHorizonLimit(hoppers(), Uniform(2, 30), "truncated")
    with pytest.warns(UserWarning, match="seeds are fixed"):
        env.reset(seed=2)
    bare.reset()
    horizons = env.horizons.copy()
    assert len(set(horizons)) == 3
    still = np.zeros((3, 3))
    for step in range(1, int(horizons.max()) + 1):
        observations, rewards, terminated, truncated, infos = env.step(still)
        expected = bare.step(still)
        first = step <= horizons  # lanes in their first episode
        assert np.array_equal(observations[first], expected[0][first])
        assert np.array_equal(rewards[first], expected[1][first])
        assert np.array_equal(truncated[first], step == horizons[first])
        assert not terminated.any()
        reset = step == horizons + 1
        assert (rewards[reset] == 0).all()
        assert (infos["elapsed_step"][reset] == 0).all()
        assert np.array_equal(env.elapsed[first], np.full(first.sum(), step))
        assert (np.abs(observations[reset, 0] - 1.25) < 0.01).all()  # a hopper starts 1.25 m up


def test_envpools_own_limit_is_seen():
    with pytest.raises(PerdureError, match=r"cuts its episodes after 1000 steps, before the longest horizon \(2000\)"):
        VectorHorizonLimit(hoppers(), Fixed(2000), "truncated")


def test_a_limit_inside_the_vector_environment_is_seen():
    pendulums = gymnasium.make_vec("Pendulum-v1", num_envs=2, vectorization_mode="sync")
    with pytest.raises(PerdureError, match="cuts its episodes after 200 steps"):
        VectorHorizonLimit(pendulums, Infinite(), "truncated")


@pytest.mark.parametrize(
    ("name", "kind", "steps"), [("Pendulum-v1", "async", 200), ("CartPole-v1", "vector_entry_point", 500)]
)
def test_a_limit_that_only_the_spec_tells_is_seen(name, kind, steps):
    vector = gymnasium.make_vec(name, num_envs=2, vectorization_mode=kind)
    with pytest.raises(PerdureError, match=f"cuts its episodes after {steps} steps"):
        VectorHorizonLimit(vector, Fixed(1000), "terminated")
    vector.close()


def test_an_environment_that_ignores_the_mask_is_found_out():
    # Gymnasium's own vectorised CartPole resets all of its lanes, whatever the mask says.
    poles = gymnasium.make_vec("CartPole-v1", num_envs=2, vectorization_mode="vector_entry_point")
    env = VectorHorizonLimit(poles, Uniform(1, 6), "truncated")
    env.reset(seed=0)
    assert env.horizons[0] != env.horizons[1]
    with pytest.raises(PerdureError, match="this vector environment ignores"):
        rows_of(env, 8)


def test_an_environment_that_does_not_say_how_it_resets_is_refused():
    silent = worlds(NEXT_STEP, {})
    del silent.metadata["autoreset_mode"]
    sentence = "must be one of AutoresetMode.NEXT_STEP, .*got None"
    with pytest.raises(PerdureError, match=sentence):
        VectorHorizonLimit(silent, Fixed(3), "terminated")
    with pytest.raises(PerdureError, match=sentence):
        VectorTimeToGoObservation(silent, Linear(), clock=Constant(3))


def test_what_cannot_work_is_refused():
    two = worlds(NEXT_STEP, {}, {})
    with pytest.raises(PerdureError, match="needs a VectorHorizonLimit below it, or a clock"):
        VectorTimeToGoObservation(two, Linear())
    with pytest.raises(PerdureError, match="2 lanes need as many clocks, got 1"):
        VectorTimeToGoObservation(two, Linear(), clock=LaneClocks([Constant(1)]))
    with pytest.raises(PerdureError, match="end must be one of"):
        VectorHorizonLimit(two, Fixed(3), "done")
    with pytest.raises(PerdureError, match="reset the vector environment before the first step"):
        VectorHorizonLimit(two, Fixed(3), "terminated").step(actions(two))
    with pytest.raises(PerdureError, match="use dict=True"):
        VectorTimeToGoObservation(worlds(NEXT_STEP, {"as_dict": True}), Linear(), clock=Constant(1))
