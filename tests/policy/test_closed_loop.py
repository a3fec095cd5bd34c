"""An episode's trajectory is its own: neighbors and their order change nothing of it."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from make_policy import random_policy

from perdure.envs import make_world
from perdure.errors import PerdureError
from perdure.horizon import Constant, Countdown, Periodic
from perdure.policy import ClosedLoop, EpisodePolicy, TaskInfo

STEPS = 60
WITH_PHI = random_policy(seed=1)
WITHOUT = random_policy(seed=2, embedding=None, activation="relu")
EPISODES = [
    (seed, episode_policy)
    for seed in (7, 8, 9, 10)
    for episode_policy in (
        EpisodePolicy(WITH_PHI, Constant(500.0)),
        EpisodePolicy(WITH_PHI, Periodic(20.0)),
        EpisodePolicy(WITHOUT, None),
        EpisodePolicy(WITH_PHI, Countdown(STEPS)),
    )
]


def trajectories(episodes, drop=(), after=0):
    """What happened in each of these episodes: bytes of its observations and rewards, by episode."""
    world = make_world("Hopper-v3", [seed for seed, _ in episodes])
    try:
        loop = ClosedLoop(world, [episode_policy for _, episode_policy in episodes])
        found = [[row.tobytes()] for row in loop.observations]
        for step in range(STEPS):
            if step == after and len(drop):
                loop.drop(np.array(drop))
            if not len(loop.running):
                break
            loop_step = loop.advance()
            for row, episode in enumerate(loop_step.episodes):
                found[episode].append(
                    loop_step.step.observations[row].tobytes() + loop_step.step.rewards[row].tobytes()
                )
    finally:
        world.close()
    return found


@pytest.fixture(scope="module")
def together():
    return trajectories(EPISODES)


def test_episodes_live_and_fall_at_different_times_and_differ(together):
    lengths = {len(episode) for episode in together}
    assert len(lengths) > 3, "episodes must fall at different steps for these tests to mean something"
    assert len({episode[1] for episode in together}) == len(EPISODES), "no two episodes may do the same"


def test_the_same_seed_starts_from_the_same_state_under_every_policy(together):
    assert [together[i][0] for i in (0, 4, 8, 12)] == [together[i + 3][0] for i in (0, 4, 8, 12)]


def test_the_order_of_the_episodes_changes_no_bit(together):
    order = np.random.default_rng(0).permutation(len(EPISODES))
    assert trajectories([EPISODES[i] for i in order]) == [together[i] for i in order]


def test_half_of_the_episodes_alone_do_what_they_did_among_all(together):
    assert trajectories(EPISODES[::2]) == together[::2]


def test_one_episode_alone_does_what_it_did_among_all(together):
    assert trajectories(EPISODES[5:6]) == together[5:6]


def test_episodes_dropped_on_the_way_are_not_missed_by_the_others(together):
    dropped = list(range(0, len(EPISODES), 2))
    found = trajectories(EPISODES, dropped, after=5)
    assert found[1::2] == together[1::2]
    assert all(len(found[episode]) <= 6 for episode in dropped)


def test_ended_episodes_are_not_stepped_again(together):
    assert min(len(episode) for episode in together) < STEPS + 1


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
        with pytest.raises(PerdureError, match=f"{task.name}.*Hopper-v3"):
            ClosedLoop(world, [EpisodePolicy(random_policy(task=task), Constant(1.0))])

    def test_each_episode_needs_a_policy(self, world):
        with pytest.raises(PerdureError, match="2 policies for 1 lanes"):
            ClosedLoop(world, [EpisodePolicy(WITHOUT, None)] * 2)

    def test_a_policy_of_another_version_of_the_same_shape_is_accepted(self, world):
        task = dataclasses.replace(WITHOUT.task, name="Hopper-v4")
        assert len(ClosedLoop(world, [EpisodePolicy(random_policy(task=task), Constant(1.0))]).running) == 1
