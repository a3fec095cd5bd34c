"""Successes that environments report in their infos arrive in `Step.successes`, through vectors in every mode."""

import math

import numpy as np
import pytest
from counting import Counting
from gymnasium.vector import AsyncVectorEnv, AutoresetMode, SyncVectorEnv

from perdure.disturbances import parse_disturbance
from perdure.envs import GymnasiumWorld, VectorEnvWorld, make_world, report_success
from perdure.envs.disturbances import DisturbedWorld
from perdure.errors import PerdureError


class Said(Counting):
    """Reports at step k the k-th value of a list, under a key; its reset reports the opposite of a success."""

    def __init__(self, said, key="is_success", falls_after=np.inf):
        super().__init__(falls_after)
        self.said, self.key = said, key

    def reset(self, **options):
        return super().reset(**options)[0], {self.key: False, "distance": 0.5}

    def step(self, action):
        value = self.said[min(self.steps, len(self.said) - 1)]
        return *super().step(action)[:4], {"distance": 0.5} | ({} if value is None else {self.key: value})


SAID = [[False, True, True], [False, False, False, True, True]]
"""The first lane ends at step 3, at its goal."""


def lanes(key="is_success"):
    return [lambda: Said(SAID[0], key, falls_after=3), lambda: Said(SAID[1], key)]


def successes(world, steps=5):
    """What each lane reports up to its end."""
    world.reset()
    running, found = np.arange(world.num_lanes), [[] for _ in range(world.num_lanes)]
    for _ in range(steps):
        step = world.step(np.zeros((len(running), 1)), running)
        values = np.full(len(running), np.nan) if step.successes is None else step.successes
        for lane, value in zip(running, values, strict=True):
            found[lane].append(value)
        running = running[~step.ended]
    return found


@pytest.mark.parametrize("key", ["is_success", "success"])
def test_single_environments_report_each_step(key):
    assert successes(GymnasiumWorld(lanes(key), [0, 1])) == SAID


@pytest.mark.parametrize("key", ["is_success", "success", "solved"])
@pytest.mark.parametrize("mode", AutoresetMode)
def test_a_vector_reports_the_last_step_of_an_episode_and_not_its_reset(mode, key):
    world = VectorEnvWorld(SyncVectorEnv(lanes(key), autoreset_mode=mode), [0, 1])
    assert successes(report_success(world, "solved" if key == "solved" else None)) == SAID


def test_so_does_one_with_processes_of_its_own():
    world = VectorEnvWorld(AsyncVectorEnv(lanes(), autoreset_mode=AutoresetMode.SAME_STEP, context="fork"), [0, 1])
    assert successes(world) == SAID
    world.close()


@pytest.mark.parametrize("mode", AutoresetMode)
def test_a_lane_that_says_nothing_at_a_step_is_unknown_there(mode):
    built = [lambda: Said([None, True, None]), lambda: Said([np.bool_(False), np.float32(1.0), np.array([0])])]
    for world in (GymnasiumWorld(built, [0, 1]), VectorEnvWorld(SyncVectorEnv(built, autoreset_mode=mode), [0, 1])):
        found = successes(world, 3)
        assert found[1] == [0.0, 1.0, 0.0]
        assert math.isnan(found[0][0])
        assert math.isnan(found[0][2])
        assert found[0][1] == 1.0


@pytest.mark.parametrize("said", ["yes", 0.7, {"grasped": True}, np.ones(3)])
def test_what_is_neither_true_nor_false_is_no_report_unless_it_is_asked_for(said):
    world = GymnasiumWorld([lambda: Said([said])], [0])
    world.reset()
    assert np.isnan(world.step(np.zeros((1, 1))).successes).all()
    report_success(world, "is_success")
    with pytest.raises(PerdureError, match="is_success"):
        world.step(np.zeros((1, 1)))


@pytest.mark.parametrize("vector", [False, True])
def test_a_named_entry_that_is_not_there_is_refused_with_those_that_are(vector):
    built = [lambda: Said([True])] * 2
    world = VectorEnvWorld(SyncVectorEnv(built), [0, 1]) if vector else GymnasiumWorld(built, [0, 1])
    report_success(world, "solved").reset()
    with pytest.raises(PerdureError, match=r"solved.*distance, is_success"):
        world.step(np.zeros((2, 1)))


def test_a_disturbed_world_passes_them_on():
    world = DisturbedWorld(
        GymnasiumWorld(lanes(), [0, 1]), [parse_disturbance("observation_noise:0.1")], [0, 1], np.ones((2, 2))
    )
    assert successes(world) == SAID


def test_engines_without_infos_report_none_and_refuse_a_name():
    world = make_world("InvertedPendulum-v4", [0])
    world.reset()
    assert world.step(np.zeros((1, 1))).successes is None
    with pytest.raises(PerdureError, match="EnvPool"):
        report_success(world, "is_success")
    world.close()


def test_a_skill_of_the_home_reports_its_own():
    world = make_world("perdure/HomePlace-v0,split=val,episodes=1", [0])
    world.reset()
    assert world.step(np.zeros((1, world.spec.action_size))).successes.tolist() == [0.0]
    world.close()
