"""`World` of EnvPool's compiled MuJoCo tasks."""

from __future__ import annotations

import ctypes
import math
import sys
from collections.abc import Sequence
from typing import Any

import numpy as np

from perdure.envs.checks import checked_actions, checked_seeds
from perdure.envs.envpool_channel import Channel, observation_keys, open_channel
from perdure.envs.errors import WorldError
from perdure.envs.lane_tracker import LaneTracker, TrackedWorld
from perdure.envs.world import FloatArray, IntArray, Step, TaskSpec

OUT_OF_REACH = 10**9
"""EnvPool's own step limit, which must never be reached: lanes have no horizon."""


class EnvPoolWorld(TrackedWorld):
    """Lanes of one EnvPool task (see `World`).

    EnvPool resets a finished environment when it is stepped again: that step ignores the action and pays 0. It never
    happens here, because an ended lane is refused until `reset` has reset it inside EnvPool too.
    """

    def __init__(self, name: str, suite: str, seeds: Sequence[int], threads: int = 1) -> None:
        """Build the pool; nothing is simulated before the first reset.

        Args:
            name: EnvPool's name of the task, e.g. "Hopper-v3".
            suite: Goes into the spec.
            seeds: One seed per lane, see `checked_seeds`.
            threads: EnvPool's threads; results do not depend on it.

        Raises:
            WorldError: If seeds or threads are not legal or the task's actions are not one box.
        """
        seeds = checked_seeds(seeds)
        if threads < 1:
            raise WorldError(f"threads must be at least 1, got {threads}.")
        self.pool: Any = _make_pool(name, seeds, threads)
        self._channel: Channel = open_channel(self.pool)
        self._spec = _spec_of(self.pool, name, suite)
        self._action_dtype = self.pool.action_space.dtype
        self._tracker = LaneTracker(len(seeds))

    def reset(self, lanes: IntArray | None = None) -> FloatArray:
        """See `World.reset`."""
        chosen = self._tracker.lanes_to_reset(lanes)
        observations = self._channel.reset(chosen.astype(np.int32))
        self._tracker.begin(chosen)
        return observations

    def step(self, actions: FloatArray, lanes: IntArray | None = None) -> Step:
        """See `World.step`."""
        chosen = self._tracker.lanes_to_step(lanes)
        clipped = checked_actions(actions, chosen, self._spec).astype(self._action_dtype, copy=False)
        observations, rewards, done, trunc = self._channel.step(clipped, chosen.astype(np.int32))
        elapsed = self._tracker.advance(chosen, done)
        return Step(
            observations,
            rewards.astype(np.float64),
            done & ~trunc,
            trunc,
            elapsed,
            np.zeros(len(chosen), np.bool_),
        )

    def close(self) -> None:
        """See `World.close`."""
        self._tracker.closed = True
        self.pool = self._channel = None  # type: ignore[assignment]  # EnvPool frees its threads with the last reference


def _make_pool(name: str, seeds: list[int], threads: int) -> Any:
    import envpool

    return envpool.make(
        name,
        env_type="gymnasium",
        num_envs=len(seeds),
        num_threads=min(threads, len(seeds)),
        seed=seeds,
        max_episode_steps=OUT_OF_REACH,
    )


def _spec_of(pool: Any, name: str, suite: str) -> TaskSpec:
    import envpool
    import gymnasium

    if not isinstance(pool.action_space, gymnasium.spaces.Box) or len(pool.action_space.shape) != 1:
        raise WorldError(f"{name}: actions must be one vector in a box, this task has {pool.action_space}.")
    shapes = pool.spec.state_array_spec
    return TaskSpec(
        name=name,
        suite=suite,
        engine=_engine_of(pool),
        observation_size=sum(math.prod(shapes[key].shape) for key in observation_keys(pool)),
        action_low=pool.action_space.low,
        action_high=pool.action_space.high,
        default_horizon=int(envpool.make_spec(name).config.max_episode_steps),
        hides_divergence=_mujoco_version(pool) is not None,
    )


def _engine_of(pool: Any) -> str:
    import envpool

    engine = f"EnvPool {envpool.__version__}"
    mujoco = _mujoco_version(pool)
    return f"{engine}, MuJoCo {mujoco}" if mujoco else engine


def _mujoco_version(pool: Any) -> str | None:
    """Return the MuJoCo version in EnvPool's extension module; None if it is unknown."""
    for base in type(pool).__mro__:
        path = getattr(sys.modules.get(base.__module__), "__file__", None)
        if base.__module__.endswith("_envpool") and path:
            try:
                ask = ctypes.CDLL(path).mj_versionString
            except (OSError, AttributeError):
                continue
            ask.restype = ctypes.c_char_p
            return str(ask().decode())
    return None
