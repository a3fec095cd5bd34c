"""EnvPool's compiled tasks as a `World`.

EnvPool's public `step` rebuilds dictionaries at every call, which costs 60 to 100 us: more than the physics of a small
batch. `EnvPoolWorld` hands arrays to the compiled pool directly, with positions looked up once from the pool's own key
lists.
"""

from __future__ import annotations

import ctypes
import math
import sys
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from perdure.envs.world import FloatArray, IntArray, Step, TaskSpec, TrackedWorld, checked_actions, checked_seeds
from perdure.errors import PerdureError

OUT_OF_REACH = 10**9
"""EnvPool's own step limit, which must never be reached: lanes have no horizon."""
STEP_SECONDS = {
    **dict.fromkeys(("Hopper", "Walker2d"), 0.008),
    **dict.fromkeys(("Humanoid", "HumanoidStandup"), 0.015),
    **dict.fromkeys(("HalfCheetah", "Ant", "InvertedDoublePendulum", "Pusher"), 0.05),
    **dict.fromkeys(("Swimmer", "InvertedPendulum"), 0.04),
    "Reacher": 0.02,
}
"""Seconds of a control step of EnvPool's MuJoCo robots, which it does not tell itself."""


class EnvPoolWorld(TrackedWorld):
    """Lanes of one EnvPool task (see `World`).

    EnvPool resets a finished environment when it is stepped again: that step ignores the action and pays 0. It never
    happens here, because an ended lane is refused until `reset` has reset it inside EnvPool too. Nothing is simulated
    before the first reset.

    Args:
        name: EnvPool's name of the task, e.g. "Hopper-v3".
        suite: Goes into the spec.
        seeds: One seed per lane, see `checked_seeds`.
        threads: EnvPool's threads; results do not depend on it.

    Raises:
        PerdureError: If seeds are not legal or the task's actions are not one box.
    """

    def __init__(self, name: str, suite: str, seeds: Sequence[int], threads: int = 1) -> None:
        import envpool

        seeds = checked_seeds(seeds)
        self.pool: Any = envpool.make(
            name,
            env_type="gymnasium",
            num_envs=len(seeds),
            num_threads=min(threads, len(seeds)),
            seed=seeds,
            max_episode_steps=OUT_OF_REACH,
        )
        keys = list(self.pool._state_keys)
        self._observed = [keys.index(key) for key in observation_keys(self.pool)]
        self._reward, self._done, self._trunc = (keys.index(key) for key in ("reward", "done", "trunc"))
        self.spec = _spec_of(self.pool, name, suite)
        self._action_dtype = self.pool.action_space.dtype
        super().__init__(len(seeds))

    def reset(self, lanes: IntArray | None = None) -> FloatArray:
        """See `World.reset`."""
        chosen = self.lanes_to_reset(lanes)
        self.pool._reset(chosen.astype(np.int32))
        observations = self._flat(self.pool._recv())
        self.begin(chosen)
        return observations

    def step(self, actions: FloatArray, lanes: IntArray | None = None) -> Step:
        """See `World.step`."""
        chosen = self.lanes_to_step(lanes)
        clipped = checked_actions(actions, chosen, self.spec).astype(self._action_dtype, copy=False)
        ids = chosen.astype(np.int32)
        self.pool._send([ids, ids, clipped])
        state = self.pool._recv()  # rows in the order of `ids`
        observations = self._flat(state)
        # EnvPool rounds rewards to single precision: those beyond its range, 3.4e38, are infinite. No finite one can
        # exceed `perdure.schema.LARGEST`, which other worlds check.
        rewards = state[self._reward].astype(np.float64)
        done = state[self._done]
        truncated = state[self._trunc]
        elapsed = self.advance(chosen, done)
        return Step(observations, rewards, done & ~truncated, truncated, elapsed, np.zeros(len(chosen), np.bool_))

    def close(self) -> None:
        """See `World.close`."""
        self.closed = True
        self.pool = None  # EnvPool frees its threads with the last reference

    def _flat(self, state: list[npt.NDArray[Any]]) -> FloatArray:
        """Return the parts of the observations, whose first axis is the lane, as vectors (n, observation_size)."""
        parts = [state[index].reshape(len(state[index]), -1) for index in self._observed]
        flat = parts[0]
        if len(parts) > 1:
            flat = np.concatenate(parts, axis=1)
        return flat.astype(np.float64, copy=False)


def _spec_of(pool: Any, name: str, suite: str) -> TaskSpec:
    import envpool
    import gymnasium

    if not isinstance(pool.action_space, gymnasium.spaces.Box) or len(pool.action_space.shape) != 1:
        raise PerdureError(f"{name}: actions must be one vector in a box, this task has {pool.action_space}.")
    shapes = pool.spec.state_array_spec
    engine = f"EnvPool {envpool.__version__}"
    mujoco = _mujoco_version(pool)
    if mujoco:
        engine += f", MuJoCo {mujoco}"
    return TaskSpec(
        name=name,
        suite=suite,
        engine=engine,
        observation_size=sum(math.prod(shapes[key].shape) for key in observation_keys(pool)),
        action_low=pool.action_space.low,
        action_high=pool.action_space.high,
        default_horizon=int(envpool.make_spec(name).config.max_episode_steps),
        hides_divergence=mujoco is not None,
        step_seconds=STEP_SECONDS.get(name.partition("-")[0], np.nan),
        has_goal="obs:desired_goal" in pool._state_keys,
    )


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


def observation_keys(pool: Any) -> list[str]:
    """Return the parts of an observation, in the order in which they are joined: the order the engine lists them in.

    For dm_control that is the order of the task's own observation dictionary, for the Shadow hand
    `observation, achieved_goal, desired_goal`. Keys are such as ["obs"] or ["obs:position", "obs:velocity"].
    """
    return [key for key in pool._state_keys if key == "obs" or key.startswith("obs:")]
