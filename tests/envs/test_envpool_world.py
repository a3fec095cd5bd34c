"""EnvPool behind the contract: the short way past its wrapper, its traps, and what its observations are made of."""

from collections.abc import Sequence

import envpool
import numpy as np
import pytest
from worlds import trajectories

from perdure.envs import make_world
from perdure.envs.envpool import EnvPoolWorld
from perdure.errors import PerdureError
from perdure.schema import LARGEST

SEEDS = [11, 12, 13]
one_of_each = pytest.mark.parametrize("task", ["Hopper-v3", "HumanoidWalk-v1", "HandReach-v3"])


def build(task: str, seeds: Sequence[int] = SEEDS, threads: int = 1) -> EnvPoolWorld:
    world = make_world(task, seeds, threads)
    assert isinstance(world, EnvPoolWorld)
    return world


class PublicPool:
    """EnvPool's documented `reset` and `step` behind the calls that a world makes."""

    def __init__(self, pool):
        self.pool, self.keys = pool, list(pool._state_keys)

    def _reset(self, ids):
        self.keep(self.pool.reset(ids)[0])

    def _send(self, job):
        ids, _, actions = job
        observations, rewards, terminated, trunc, _ = self.pool.step(actions, ids)
        self.keep(observations, reward=rewards, done=terminated | trunc, trunc=trunc)

    def keep(self, observations, **others):
        parts = observations if isinstance(observations, dict) else {"": observations}
        self.state = {f"obs:{name}".rstrip(":"): part for name, part in parts.items()} | others

    def _recv(self):
        return [self.state.get(key) for key in self.keys]


@one_of_each
def test_the_short_way_and_the_public_way_agree_bit_for_bit(task: str) -> None:
    raw, public = build(task), build(task)
    public.pool = PublicPool(public.pool)
    for order in ([0, 1, 2], [2, 0, 1]):
        ours, expected = trajectories(raw, SEEDS, 25, order), trajectories(public, SEEDS, 25, order)
        assert all(np.array_equal(a, b) for a, b in zip(ours, expected, strict=True))


@one_of_each
def test_the_number_of_threads_changes_nothing(task: str) -> None:
    seeds = [5, 4, 3, 2, 1]
    alone, together = trajectories(build(task, seeds), seeds, 15), trajectories(build(task, seeds, 2), seeds, 15)
    assert all(np.array_equal(a, b) for a, b in zip(alone, together, strict=True))


def test_a_fall_shows_the_fallen_robot_and_the_reset_a_standing_one() -> None:
    """Hopper is healthy while its height exceeds 0.7 and its pitch stays within 0.2 rad."""
    world, falls = build("Hopper-v3", [1, 2, 3, 4]), 0
    world.reset()
    for _ in range(150):
        step = world.step(np.ones((4, 3)))
        height, pitch = step.observations[:, 0], step.observations[:, 1]
        healthy = (height > 0.7) & (np.abs(pitch) < 0.2)
        assert np.array_equal(step.terminated, ~healthy)
        assert not step.truncated.any()
        fallen = np.flatnonzero(step.terminated)
        falls += len(fallen)
        if len(fallen):
            first = world.reset(fallen)
            assert (np.abs(first[:, 0] - 1.25) <= 0.005).all()  # it starts at 1.25, give or take its reset noise
            assert (world.elapsed[fallen] == 0).all()
    assert falls >= 4


@one_of_each
def test_no_finite_reward_is_so_large_that_sums_overflow(task: str) -> None:
    """Other worlds refuse a reward above `LARGEST`; EnvPool's number format cannot hold one."""
    kind = build(task).pool.spec.state_array_spec["reward"].dtype
    assert float(np.finfo(kind).max) < LARGEST


def test_the_step_after_a_reset_obeys_its_action() -> None:
    """EnvPool's own reset step pays 0 and discards the action; a lane that is reset in time never sees it."""
    world, fresh = build("Hopper-v3", [1]), build("Hopper-v3", [1])
    world.reset()
    while not world.step(np.ones((1, 3))).terminated[0]:
        pass
    fresh.reset()
    assert np.array_equal(world.reset(), fresh.reset())  # both are the second start of seed 1
    for _ in range(3):
        after, expected = world.step(-np.ones((1, 3))), fresh.step(-np.ones((1, 3)))
        assert np.array_equal(after.observations, expected.observations)
        assert after.rewards[0] == expected.rewards[0] != 0


def test_the_row_it_avoids_does_exist() -> None:
    pool = envpool.make("Hopper-v3", env_type="gymnasium", num_envs=1, seed=[1])
    pool.reset()
    while not pool.step(np.ones((1, 3)))[2][0]:
        pass
    assert pool.step(np.ones((1, 3)))[1][0] == 0


def test_the_suites_own_limit_of_1000_steps_is_out_of_reach() -> None:
    world = build("HalfCheetah-v3", [1])
    assert world.spec.default_horizon == 1000
    world.reset()
    for _ in range(1003):
        step = world.step(np.zeros((1, 6)))
        assert not step.ended.any()
    assert step.elapsed[0] == 1003


def test_a_negative_control_for_that_limit() -> None:
    pool = envpool.make("HalfCheetah-v3", env_type="gymnasium", num_envs=1, max_episode_steps=5)
    pool.reset()
    for _ in range(5):
        truncated = pool.step(np.zeros((1, 6)))[3]
    assert truncated[0]


@pytest.mark.parametrize(
    ("task", "parts"),
    [
        ("CheetahRun-v1", ["position", "velocity"]),
        (
            "HumanoidWalk-v1",
            ["joint_angles", "head_height", "extremities", "torso_vertical", "com_velocity", "velocity"],
        ),
        ("HandReach-v3", ["observation", "achieved_goal", "desired_goal"]),
    ],
)
def test_dictionary_observations_are_joined_in_the_engines_order(task: str, parts: list[str]) -> None:
    pool = envpool.make(task, env_type="gymnasium", num_envs=3, seed=SEEDS)
    observations, _ = pool.reset()
    # EnvPool shows HumanoidWalk's raw position between two parts that dm_control has; it stays in its place
    joined = np.concatenate([part.reshape(3, -1) for part in observations.values()], axis=1)
    assert [name for name in observations if name in parts] == parts
    assert np.array_equal(build(task).reset(), joined)


def test_the_engine_is_named_with_its_versions() -> None:
    engine = build("Hopper-v3").spec.engine
    assert engine.startswith(f"EnvPool {envpool.__version__}")
    if envpool.__version__ == "1.2.5":
        assert engine == "EnvPool 1.2.5, MuJoCo 3.6.0"


@pytest.mark.parametrize("seeds", [[], [-1], [2**31], [1.5], 7, "12", [[1, 2]], [[1], [2, 3]], [True]])
def test_impossible_seeds_are_refused(seeds: object) -> None:
    with pytest.raises(PerdureError, match=r"[Ss]eed"):
        make_world("Hopper-v3", seeds)


def test_the_largest_seed_and_repeated_seeds_are_legal() -> None:
    first = build("Hopper-v3", np.array([2**31 - 1, 0, 2**31 - 1])).reset()
    assert np.array_equal(first[0], first[2])
    assert not np.array_equal(first[0], first[1])


def test_zero_threads_are_refused() -> None:
    with pytest.raises(PerdureError, match=r"threads.*0"):
        make_world("Hopper-v3", [1], threads=0)


def test_a_discrete_task_is_refused() -> None:
    with pytest.raises(PerdureError, match=r"one vector in a box.*Discrete"):
        EnvPoolWorld("CartPole-v1", "test", [1])
