"""What every world promises, on a sample of every suite (`make test`) and on every registered task (`make verify`)."""

from collections.abc import Iterator
from functools import cache

import numpy as np
import pytest
from worlds import CASES, SAMPLE_CASES, Case, actions_of, trajectories

from perdure.envs import VectorEnvWorld, World
from perdure.errors import PerdureError

SEEDS = [11, 12, 13]
STEPS = 6


@pytest.fixture(params=CASES)
def case(request: pytest.FixtureRequest) -> Case:
    return request.param


@pytest.fixture
def world(case: Case) -> Iterator[World]:
    built = case.build(SEEDS)
    yield built
    built.close()


every_sample = pytest.mark.parametrize("case", SAMPLE_CASES, indirect=True)


def plan(world: World, steps: int = STEPS) -> np.ndarray:
    """Actions of all lanes, shape (steps, lanes, action_size)."""
    return np.stack([actions_of(seed, world, steps) for seed in SEEDS], axis=1)


@cache
def told(case: Case) -> list[np.ndarray]:
    """The trajectories that others are compared with, simulated once per case."""
    return trajectories(case.build(SEEDS), SEEDS, STEPS)


def test_the_same_seeds_give_the_same_trajectories_and_other_seeds_do_not(case: Case, world: World) -> None:
    assert all(np.array_equal(a, b) for a, b in zip(told(case), trajectories(world, SEEDS, STEPS), strict=True))
    others = trajectories(case.build([91, 92, 93]), SEEDS, STEPS)  # the same actions from other seeds
    assert not any(np.array_equal(a, b) for a, b in zip(told(case), others, strict=True))


def test_a_lane_does_not_feel_its_place_nor_its_neighbors(case: Case) -> None:
    alone = dict(zip(SEEDS, told(case), strict=True))
    for seeds in ([13], [12, 13, 12, 11]):
        for seed, lane in zip(seeds, trajectories(case.build(seeds), seeds, STEPS), strict=True):
            assert np.array_equal(lane, alone[seed]), f"seed {seed} among {seeds}"


def test_the_order_in_which_lanes_are_named_does_not_matter(case: Case, world: World) -> None:
    shuffled = trajectories(world, SEEDS, STEPS, order=[2, 0, 1])
    assert all(np.array_equal(a, b) for a, b in zip(told(case), shuffled, strict=True))


def test_observations_rewards_and_flags_have_the_promised_shapes(world: World) -> None:
    spec = world.spec
    assert world.num_lanes == len(SEEDS)
    assert spec.default_horizon >= 1
    assert spec.action_low.shape == spec.action_high.shape == (spec.action_size,)
    assert world.reset().shape == (3, spec.observation_size)
    step = world.step(plan(world)[0])
    assert step.observations.shape == (3, spec.observation_size)
    assert step.observations.dtype == step.rewards.dtype == np.float64
    assert step.rewards.shape == step.terminated.shape == step.truncated.shape == (3,)
    assert step.terminated.dtype == step.truncated.dtype == np.bool_
    assert step.elapsed.tolist() == [1, 1, 1]
    assert step.diverged.tolist() == [False, False, False]
    assert np.isfinite(step.observations).all()


ENDING = [
    case for case in SAMPLE_CASES if case.id in ("Hopper-v3", "InvertedPendulum-v2", "falling", "vector-DISABLED")
]
"""Cases whose episodes end within 200 steps of full actions."""


@pytest.mark.parametrize("case", ENDING, indirect=True)
def test_an_ended_lane_is_refused_until_it_is_reset_and_the_refusal_moves_nothing(case: Case, world: World) -> None:
    world.reset()
    full, alive = np.tile(world.spec.action_high, (3, 1)), np.arange(3)
    for _ in range(200):
        step = world.step(full[alive], alive)
        alive = alive[~step.ended]
        if len(alive) < 3:
            break
    ended = np.setdiff1d(np.arange(3), alive)
    assert len(ended)
    before = world.elapsed
    with pytest.raises(PerdureError, match="have ended"):
        world.step(full)
    assert np.array_equal(world.elapsed, before)
    again = world.reset(ended)
    assert again.shape == (len(ended), world.spec.observation_size)
    assert not world.elapsed[ended].any()
    assert len(world.step(full).elapsed) == 3


@every_sample
def test_lanes_that_were_never_reset_are_refused(world: World) -> None:
    with pytest.raises(PerdureError, match="0, 1, 2"):
        world.step(plan(world)[0])
    world.reset(np.array([1]))
    with pytest.raises(PerdureError, match="0, 2"):
        world.step(plan(world)[0])
    assert world.step(plan(world)[0][1:2], np.array([1])).elapsed.tolist() == [1]


def test_stepping_some_lanes_leaves_the_others_where_they_are(case: Case, world: World) -> None:
    if isinstance(world, VectorEnvWorld):  # moves all lanes at once
        world.reset()
        with pytest.raises(PerdureError, match=r"lanes \[0 2\] are running"):
            world.step(plan(world)[0][1:2], np.array([1]))
        return
    actions, twin = plan(world), case.build(SEEDS)
    world.reset(), twin.reset()
    for k in range(3):
        expected = twin.step(actions[k])
    for k in range(3):  # lane 1 alone first, then the other two
        alone = world.step(actions[k][1:2], np.array([1]))
    assert world.elapsed.tolist() == [0, 3, 0]
    for k in range(3):
        others = world.step(actions[k][[2, 0]], np.array([2, 0]))
    assert np.array_equal(alone.observations[0], expected.observations[1])
    assert np.array_equal(others.observations, expected.observations[[2, 0]])
    assert np.array_equal(others.rewards, expected.rewards[[2, 0]])


def test_resetting_one_lane_leaves_the_others_where_they_are(case: Case, world: World) -> None:
    actions, twin = plan(world), case.build(SEEDS)
    for one in (world, twin):
        one.reset()
        one.step(actions[0])
    world.reset(np.array([1]))
    assert world.elapsed.tolist() == [1, 0, 1]
    ours, expected = world.step(actions[1]), twin.step(actions[1])
    assert np.array_equal(ours.observations[[0, 2]], expected.observations[[0, 2]])
    assert not np.array_equal(ours.observations[1], expected.observations[1])


@every_sample
def test_an_episode_does_not_remember_how_the_one_before_it_went(case: Case) -> None:
    world = case.build([11, 11])
    actions = actions_of(11, world, STEPS)
    world.reset()
    for k in range(3):
        world.step(actions[[k, k + 1]])
    first = world.reset()
    assert np.array_equal(first[0], first[1])
    for k in range(3):
        step = world.step(actions[[k, k]])
        assert np.array_equal(step.observations[0], step.observations[1])
        assert step.rewards[0] == step.rewards[1]


@every_sample
def test_an_abandoned_lane_is_refused_until_it_is_reset_and_the_others_go_on(case: Case, world: World) -> None:
    actions = plan(world)
    world.reset()
    world.step(actions[0])
    world.abandon(np.array([1]))
    with pytest.raises(PerdureError, match="ended"):
        world.step(actions[1])
    others = world.step(actions[1][[0, 2]], np.array([0, 2]))
    for row, lane in enumerate((0, 2)):
        size = world.spec.observation_size
        assert np.array_equal(others.observations[row], told(case)[lane][2][:size]), "as if it had never been there"
    with pytest.raises(PerdureError, match="do not exist"):
        world.abandon(np.array([3]))
    world.reset(np.array([1]))
    assert world.step(actions[2]).elapsed.tolist() == [3, 1, 3]


@every_sample
def test_impossible_lanes_are_refused(world: World) -> None:
    world.reset()
    for lanes in ([3], [-1], [0, 0], [[0]], [], [0.0], [True, False, True], 1, [[0], [1, 2]]):
        with pytest.raises(PerdureError, match=r"[Ll]anes"):
            world.reset(lanes)
        with pytest.raises(PerdureError, match=r"[Ll]anes"):
            world.step(plan(world)[0], lanes)
    assert world.elapsed.tolist() == [0, 0, 0]


@every_sample
def test_actions_of_a_wrong_shape_or_without_a_value_are_refused_and_move_nothing(case: Case, world: World) -> None:
    actions, twin = plan(world), case.build(SEEDS)
    world.reset(), twin.reset()
    nan = actions[0].copy()
    nan[1, -1] = np.nan
    with pytest.raises(PerdureError, match="lane 1 is NaN"):
        world.step(nan)
    for wrong in (actions[0][:2], actions[0][:, :0], actions[0].ravel(), "left"):
        with pytest.raises(PerdureError, match="actions must"):
            world.step(wrong)
    assert np.array_equal(world.step(actions[0]).observations, twin.step(actions[0]).observations)


@every_sample
def test_actions_are_clipped_to_the_box(case: Case, world: World) -> None:
    spec, twin = world.spec, case.build(SEEDS)
    world.reset(), twin.reset()
    beyond = np.stack([spec.action_high + 5, spec.action_low - 5, np.full(spec.action_size, np.inf)])
    edge = np.stack([spec.action_high, spec.action_low, spec.action_high])
    before = beyond.copy()
    clipped, exact = world.step(beyond), twin.step(edge)
    assert np.array_equal(clipped.observations, exact.observations)
    assert np.array_equal(clipped.rewards, exact.rewards)
    assert np.array_equal(beyond, before)


@every_sample
def test_results_belong_to_the_caller(case: Case, world: World) -> None:
    actions, twin = plan(world), case.build(SEEDS)
    twin.reset()
    kept = [world.reset()]
    for k in range(3):
        step, expected = world.step(actions[k]), twin.step(actions[k])
        assert np.array_equal(step.observations, expected.observations)
        assert not any(np.shares_memory(step.observations, earlier) for earlier in kept)
        kept.append(step.observations)
        for array in (step.observations, step.rewards, step.elapsed, step.terminated, world.elapsed):
            array[:] = 1  # a caller may scribble on what it was given


@every_sample
def test_a_closed_world_is_refused_and_closes_twice(case: Case) -> None:
    world = case.build(SEEDS)
    world.reset()
    world.close()
    world.close()
    with pytest.raises(PerdureError, match="closed"):
        world.reset()
    with pytest.raises(PerdureError, match="closed"):
        world.step(plan(world)[0])
