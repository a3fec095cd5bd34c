"""Exchange arrays with an EnvPool pool, directly or through its Python wrapper.

EnvPool's public `step` rebuilds dictionaries at every call, which costs 60 to 100 us: more than the physics of a small
batch. `RawChannel` hands arrays to the compiled pool directly, with positions looked up once from the pool's own key
lists. Where those lists do not look as expected, `open_channel` falls back to `PublicChannel`.
"""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from perdure.envs.world import BoolArray, FloatArray

ACTION_KEYS = ["env_id", "players.env_id", "action"]
Int32Array = npt.NDArray[np.int32]
Outcome = tuple[FloatArray, npt.NDArray[np.float32], BoolArray, BoolArray]


class Channel(Protocol):
    """Moves arrays in and out of one pool. Rows come back in the order of `ids`."""

    def reset(self, ids: Int32Array) -> FloatArray:
        """Reset these environments; return their first observations, shape (n, observation_size)."""

    def step(self, actions: npt.NDArray[Any], ids: Int32Array) -> Outcome:
        """Step these environments; return observations, rewards, done (any end) and trunc (EnvPool's step limit)."""


class RawChannel:
    """The compiled pool's own send and receive."""

    def __init__(self, pool: Any) -> None:
        """Find the position of each array.

        Args:
            pool: An EnvPool pool for which `has_known_layout` is true.
        """
        keys = list(pool._state_keys)
        self._reset, self._send, self._recv = pool._reset, pool._send, pool._recv
        self._observed = [keys.index(key) for key in observation_keys(pool)]
        self._reward, self._done, self._trunc = (keys.index(key) for key in ("reward", "done", "trunc"))

    def reset(self, ids: Int32Array) -> FloatArray:
        """See `Channel.reset`."""
        self._reset(ids)
        return self._flat(self._recv())

    def step(self, actions: npt.NDArray[Any], ids: Int32Array) -> Outcome:
        """See `Channel.step`."""
        self._send([ids, ids, actions])
        state = self._recv()
        return self._flat(state), state[self._reward], state[self._done], state[self._trunc]

    def _flat(self, state: list[npt.NDArray[Any]]) -> FloatArray:
        return flat_observations([state[index] for index in self._observed])


class PublicChannel:
    """EnvPool's documented `reset` and `step`."""

    def __init__(self, pool: Any) -> None:
        """Wrap a pool.

        Args:
            pool: An EnvPool pool made with `env_type="gymnasium"`.
        """
        self._pool = pool
        self._names = [key.split(":")[1:] for key in observation_keys(pool)]

    def reset(self, ids: Int32Array) -> FloatArray:
        """See `Channel.reset`."""
        observations, _ = self._pool.reset(ids)
        return self._flat(observations)

    def step(self, actions: npt.NDArray[Any], ids: Int32Array) -> Outcome:
        """See `Channel.step`."""
        observations, rewards, terminated, trunc, _ = self._pool.step(actions, ids)
        return self._flat(observations), rewards, terminated | trunc, trunc

    def _flat(self, observations: Any) -> FloatArray:
        if not isinstance(observations, dict):
            return flat_observations([observations])
        return flat_observations([observations[name] for (name,) in self._names])


def open_channel(pool: Any) -> Channel:
    """Return the fastest channel this pool's layout allows.

    Args:
        pool: An EnvPool pool made with `env_type="gymnasium"`.

    Returns:
        A `RawChannel` where the layout is known, else a `PublicChannel`.
    """
    return RawChannel(pool) if has_known_layout(pool) else PublicChannel(pool)


def has_known_layout(pool: Any) -> bool:
    """Return whether the pool has the array layout that `RawChannel` expects.

    Args:
        pool: Any pool.

    Returns:
        True if so.
    """
    if not all(hasattr(pool, name) for name in ("_reset", "_send", "_recv", "_state_keys", "_action_keys")):
        return False
    flags = {"reward", "done", "trunc"} <= set(pool._state_keys)
    return flags and list(pool._action_keys) == ACTION_KEYS


def observation_keys(pool: Any) -> list[str]:
    """Return the parts of an observation, in the order in which they are joined: the order the engine lists them in.

    For dm_control that is the order of the task's own observation dictionary, for the Shadow hand
    `observation, achieved_goal, desired_goal`.

    Args:
        pool: An EnvPool pool.

    Returns:
        Keys such as ["obs"] or ["obs:position", "obs:velocity"].
    """
    return [key for key in pool._state_keys if key == "obs" or key.startswith("obs:")]


def flat_observations(parts: list[npt.NDArray[Any]]) -> FloatArray:
    """Join the parts of an observation into one vector per row.

    Args:
        parts: Arrays whose first axis is the lane; a part of shape (n,) is one number per lane.

    Returns:
        Shape (n, observation_size), float64.
    """
    flat = [part if part.ndim == 2 else part.reshape(len(part), -1) for part in parts]
    joined = flat[0] if len(flat) == 1 else np.concatenate(flat, axis=1)
    return joined.astype(np.float64, copy=False)
