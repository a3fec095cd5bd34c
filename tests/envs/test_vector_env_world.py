"""Any VectorEnv: the same numbers in all three autoreset modes, a sentence where one cannot keep the contract."""

from typing import Any

import gymnasium
import numpy as np
import pytest
from counting import Counting, factories, first_starts
from gymnasium.vector import AsyncVectorEnv, AutoresetMode, SyncVectorEnv
from worlds import counting_vector, trajectories

from perdure.envs.vector_env import VectorEnvWorld
from perdure.errors import PerdureError

every_mode = pytest.mark.parametrize("mode", list(AutoresetMode))


def vector(count: int, mode: AutoresetMode, **options: Any) -> SyncVectorEnv:
    return SyncVectorEnv(factories(count, **options), autoreset_mode=mode)


@every_mode
@pytest.mark.parametrize("as_dict", [False, True])
def test_the_last_observation_is_that_of_the_fall_in_every_mode(mode: AutoresetMode, as_dict: bool) -> None:
    world = counting_vector([5, 6], mode, falls_after=2, as_dict=as_dict)
    starts = [first_starts(seed, 1)[0] for seed in (5, 6)]
    assert world.reset().tolist() == [[starts[0], 0], [starts[1], 0]]
    world.step(np.zeros((2, 1)))
    step = world.step(np.array([[0.5], [-0.5]]))
    assert step.observations.tolist() == [[starts[0], 2], [starts[1], 2]]
    assert step.rewards.tolist() == [20.5, 19.5]
    assert step.terminated.all()


@every_mode
def test_ended_lanes_are_ignored_and_leave_no_trace_in_their_next_episode(mode: AutoresetMode) -> None:
    def second_start(steps_of_the_other_lane: int) -> float:
        built = [*factories(1, falls_after=2), *factories(1, falls_after=9)]
        world = VectorEnvWorld(SyncVectorEnv(built, autoreset_mode=mode), [5, 6])
        world.reset()
        for _ in range(2):
            world.step(np.zeros((2, 1)))
        for k in range(steps_of_the_other_lane):
            step = world.step(np.full((1, 1), 0.5), np.array([1]))
            assert step.observations[0, 1] == k + 3
            assert step.rewards[0] == 10 * (k + 3) + 0.5
        assert world.elapsed.tolist() == [2, 2 + steps_of_the_other_lane]
        return float(world.reset(np.array([0]))[0, 0])

    assert second_start(1) == second_start(5)
    assert second_start(5) != first_starts(5, 1)[0]


@pytest.mark.parametrize("falls_after", [1, 3])
def test_the_three_modes_and_worker_processes_tell_the_same_story(falls_after: int) -> None:
    seeds = [5, 6, 7]
    stories = [trajectories(counting_vector(seeds, mode, falls_after=falls_after), seeds, 8) for mode in AutoresetMode]
    workers = VectorEnvWorld(AsyncVectorEnv(factories(3, falls_after=falls_after), context="fork"), seeds)
    stories.append(trajectories(workers, seeds, 8))
    workers.close()
    for story in stories[1:]:
        assert all(np.array_equal(a, b) for a, b in zip(stories[0], story, strict=True))


def test_ended_lanes_get_the_action_of_the_box_nearest_to_zero() -> None:
    given: list[list[float]] = []

    class Recording(Counting):
        def __init__(self, falls_after: float = np.inf) -> None:
            super().__init__(falls_after)
            self.action_space = gymnasium.spaces.Box(np.array([-1.0, 0.5]), np.array([1.0, 2.0]), (2,), np.float64)

        def step(self, action: Any) -> Any:
            given.append(action.tolist())
            return super().step(action)

    built = [lambda: Recording(falls_after=1), Recording]
    world = VectorEnvWorld(SyncVectorEnv(built, autoreset_mode=AutoresetMode.DISABLED), [1, 2])
    world.reset()
    world.step(np.ones((2, 2)))
    world.step(np.ones((1, 2)), np.array([1]))
    assert given == [[1, 1], [1, 1], [0, 0.5], [1, 1]]


def test_a_vector_that_ignores_the_reset_mask_is_refused() -> None:
    class Deaf(SyncVectorEnv):
        def reset(self, *, seed: Any = None, options: Any = None) -> Any:
            return super().reset(seed=seed)

    world = VectorEnvWorld(Deaf(factories(2), autoreset_mode=AutoresetMode.DISABLED), [5, 6])
    world.reset()
    world.step(np.zeros((2, 1)))
    with pytest.raises(PerdureError, match=r"\[0\].*reset_mask"):
        world.reset(np.array([0]))


def test_a_vector_that_does_not_say_how_it_resets_is_refused() -> None:
    silent = vector(1, AutoresetMode.DISABLED)
    del silent.metadata["autoreset_mode"]
    with pytest.raises(PerdureError, match=r"NEXT_STEP, SAME_STEP, DISABLED.*None"):
        VectorEnvWorld(silent, [1])


def test_seeds_must_match_the_environments() -> None:
    with pytest.raises(PerdureError, match=r"2.*3"):
        VectorEnvWorld(vector(2, AutoresetMode.DISABLED), [1, 2, 3])


def test_it_describes_what_gymnasium_knows() -> None:
    env = gymnasium.make_vec("Pendulum-v1", 2, vectorization_mode="sync")
    spec = VectorEnvWorld(env, [1, 2], name="pendulum").spec
    assert (spec.name, spec.observation_size, spec.default_horizon) == ("pendulum", 3, 200)
    assert spec.action_low.tolist() == [-2.0]
    assert spec.engine == f"Gymnasium {gymnasium.__version__}"


class Reports(Counting):
    """Says in its info that it diverged, and is cut at the same step."""

    def step(self, action: Any) -> Any:
        observation, reward, *_ = super().step(action)
        return observation, reward, False, True, {"diverged": True}


@every_mode
def test_a_divergence_that_a_lane_reports_is_seen_in_every_mode(mode: AutoresetMode) -> None:
    world = VectorEnvWorld(SyncVectorEnv([Reports, Counting], autoreset_mode=mode), [5, 6])
    world.reset()
    assert world.step(np.zeros((2, 1))).diverged.tolist() == [True, False]


def test_a_divergence_of_mujoco_in_this_process_is_read_from_the_engine() -> None:
    def build() -> gymnasium.Env:
        return gymnasium.make("HalfCheetah-v5", max_episode_steps=-1)

    vector = SyncVectorEnv([build, build])
    world = VectorEnvWorld(vector, [5, 6])
    world.reset()
    assert not world.step(np.zeros((2, 6))).diverged.any()
    vector.envs[1].unwrapped.data.qvel[:] = 1e12
    assert world.step(np.zeros((2, 6))).diverged.tolist() == [False, True]
