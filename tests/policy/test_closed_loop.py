"""A lane's trajectory is its own: neighbors and their order change nothing of it."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from make_policy import random_policy

from perdure.envs import make_world
from perdure.errors import PerdureError
from perdure.horizon import Constant, Countdown, Periodic
from perdure.policy import ClosedLoop, LanePolicy, TaskInfo

STEPS = 60
WITH_PHI = random_policy(seed=1)
WITHOUT = random_policy(seed=2, embedding=None, activation="relu")
LANES = [
    (seed, lane_policy)
    for seed in (7, 8, 9, 10)
    for lane_policy in (
        LanePolicy(WITH_PHI, Constant(500.0)),
        LanePolicy(WITH_PHI, Periodic(20.0)),
        LanePolicy(WITHOUT, None),
        LanePolicy(WITH_PHI, Countdown(STEPS)),
    )
]


def trajectories(lanes, drop=(), after=0):
    """What happened in each of these lanes: bytes of its observations and rewards, by lane."""
    world = make_world("Hopper-v3", [seed for seed, _ in lanes])
    try:
        loop = ClosedLoop(world, [lane_policy for _, lane_policy in lanes])
        found = [[row.tobytes()] for row in loop.observations]
        for step in range(STEPS):
            if step == after and len(drop):
                loop.drop(np.array(drop))
            if not len(loop.running):
                break
            lane_step = loop.advance()
            for row, lane in enumerate(lane_step.lanes):
                found[lane].append(lane_step.step.observations[row].tobytes() + lane_step.step.rewards[row].tobytes())
    finally:
        world.close()
    return found


@pytest.fixture(scope="module")
def together():
    return trajectories(LANES)


def test_lanes_live_and_fall_at_different_times_and_differ(together):
    lengths = {len(lane) for lane in together}
    assert len(lengths) > 3, "lanes must fall at different steps for these tests to mean something"
    assert len({lane[1] for lane in together}) == len(LANES), "no two lanes may do the same"


def test_the_same_seed_starts_from_the_same_state_under_every_policy(together):
    assert [together[i][0] for i in (0, 4, 8, 12)] == [together[i + 3][0] for i in (0, 4, 8, 12)]


def test_the_order_of_the_lanes_changes_no_bit(together):
    order = np.random.default_rng(0).permutation(len(LANES))
    assert trajectories([LANES[i] for i in order]) == [together[i] for i in order]


def test_half_of_the_lanes_alone_do_what_they_did_among_all(together):
    assert trajectories(LANES[::2]) == together[::2]


def test_one_lane_alone_does_what_it_did_among_all(together):
    assert trajectories(LANES[5:6]) == together[5:6]


def test_lanes_dropped_on_the_way_are_not_missed_by_the_others(together):
    dropped = list(range(0, len(LANES), 2))
    found = trajectories(LANES, dropped, after=5)
    assert found[1::2] == together[1::2]
    assert all(len(found[lane]) <= 6 for lane in dropped)


def test_ended_lanes_are_not_stepped_again(together):
    assert min(len(lane) for lane in together) < STEPS + 1


class TestPoliciesThatDoNotFit:
    @pytest.fixture
    def world(self):
        world = make_world("Hopper-v3", [0])
        yield world
        world.close()

    @pytest.mark.parametrize(
        "task",
        [TaskInfo("HalfCheetah-v3", 17, (-1.0,) * 6, (1.0,) * 6), TaskInfo("Hopper", 11, (-2.0,) * 3, (2.0,) * 3)],
    )
    def test_are_refused_by_name(self, world, task):
        with pytest.raises(PerdureError, match=f"policy for {task.name}.*Hopper-v3"):
            ClosedLoop(world, [LanePolicy(random_policy(task=task), Constant(1.0))])

    def test_each_lane_needs_a_policy(self, world):
        with pytest.raises(PerdureError, match="2 policies for 1 lanes"):
            ClosedLoop(world, [LanePolicy(WITHOUT, None)] * 2)

    def test_a_policy_of_another_version_of_the_same_shape_is_accepted(self, world):
        task = dataclasses.replace(WITHOUT.task, name="Hopper-v4")
        assert len(ClosedLoop(world, [LanePolicy(random_policy(task=task), Constant(1.0))]).running) == 1
