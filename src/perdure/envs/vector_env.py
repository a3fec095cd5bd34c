"""Any Gymnasium `VectorEnv` as a `World`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from perdure.envs.gymnasium import (
    call,
    divergence_count,
    read_observation,
    read_reward,
    read_tuple,
    shaped_actions,
    spec_of,
)
from perdure.envs.world import (
    MAX_SEED,
    BoolArray,
    FloatArray,
    IntArray,
    Step,
    TrackedWorld,
    checked_actions,
    checked_seeds,
)
from perdure.errors import PerdureError
from perdure.schema import LARGEST


class VectorEnvWorld(TrackedWorld):
    """Lanes of one `VectorEnv` (see `World`).

    A `VectorEnv` moves all its environments at every step. So every running lane must be stepped together; lanes that
    have ended get the action nearest to zero and what they do is ignored. Every episode is started with a seed made
    from the lane's seed and the number of its episode, so ended episodes have no effect on later ones.

    All three autoreset modes work: `AutoresetMode.DISABLED` is the plain one; with `NEXT_STEP` the self-made resets
    happen in ended lanes only; with `SAME_STEP` the last observation is taken from `info["final_obs"]`. Resetting some
    of the lanes needs a `VectorEnv` that follows Gymnasium's `options["reset_mask"]`; resetting all at once does not.

    Args:
        env: A `gymnasium.vector.VectorEnv`. Its environments should not have a TimeLimit; one is reported as
            `truncated`.
        seeds: One per environment, see `checked_seeds`.
        name: Goes into the spec.
        suite: Goes into the spec.
        default_horizon: Goes into the spec; None means the environment's own limit.

    Raises:
        PerdureError: If seeds and environments do not match, the spaces do not fit the contract or the vector does not
            say how it resets itself.
    """

    def __init__(
        self,
        env: Any,
        seeds: Sequence[int],
        name: str = "custom",
        suite: str = "Gymnasium",
        default_horizon: int | None = None,
    ) -> None:
        from gymnasium.vector import AutoresetMode

        self._seeds = checked_seeds(seeds)
        if env.num_envs != len(self._seeds):
            raise PerdureError(f"{name}: {env.num_envs} environments need as many seeds, got {len(self._seeds)}.")
        self._mode = env.metadata.get("autoreset_mode")
        if not isinstance(self._mode, AutoresetMode):
            modes = ", ".join(mode.name for mode in AutoresetMode)
            raise PerdureError(f"{name}: metadata['autoreset_mode'] must be one of {modes}, got {self._mode!r}.")
        self._env = env
        self._space = env.single_observation_space
        self._action_space = env.single_action_space
        self.spaces = (self._space, self._action_space)
        limit = default_horizon
        if limit is None:
            limit = getattr(env.spec, "max_episode_steps", None)
        engine = getattr(env, "envs", [env])[0]
        self.spec = spec_of(name, suite, engine, self.spaces, limit)
        super().__init__(len(self._seeds))
        self._episodes = np.zeros(len(self._seeds), dtype=np.int64)
        self._over = np.zeros(len(self._seeds), dtype=np.bool_)  # ended inside the vector, not reset since
        self._shown: FloatArray | None = None  # what the vector showed last, all lanes

    def reset(self, lanes: IntArray | None = None) -> FloatArray:
        """See `World.reset`."""
        chosen = self.lanes_to_reset(lanes)
        mask = np.zeros(self.num_lanes, dtype=np.bool_)
        mask[chosen] = True
        shown = self._reset_inside(mask, [self._episode_seed(lane) for lane in range(self.num_lanes)])
        self._episodes[chosen] += 1
        self.begin(chosen)
        return shown[chosen]

    def step(self, actions: FloatArray, lanes: IntArray | None = None) -> Step:
        """See `World.step`; all running lanes must be stepped together."""
        from gymnasium.vector import AutoresetMode

        chosen = self.lanes_to_step(lanes)
        behind = self.running
        behind[chosen] = False
        if behind.any():
            raise PerdureError(
                f"{self.spec.name}: a VectorEnv moves all lanes at once, but lanes {np.flatnonzero(behind)} are "
                "running and were left out. Step every running lane, or give the single environments to GymnasiumWorld."
            )
        clipped = checked_actions(actions, chosen, self.spec)
        # The vector moves lanes that have ended too: reset them if it does not, and let them do nothing.
        if self._mode is AutoresetMode.DISABLED and self._over.any():
            self._reset_inside(self._over.copy(), [None] * self.num_lanes)
        idle = np.clip(np.zeros(self.spec.action_size), self.spec.action_low, self.spec.action_high)
        everyone = np.tile(idle, (self.num_lanes, 1))
        everyone[chosen] = clipped
        # Step, and check what came back.
        name = self.spec.name
        returned = call(name, "step", self._env.step, shaped_actions(self._action_space, everyone))
        batch, rewards, terminated, truncated, info = read_tuple(name, "step", returned, 5)
        rewards = self._column("rewards", rewards, "fiu").astype(np.float64)
        for lane in np.flatnonzero(np.abs(rewards) > LARGEST):  # rare: nan compares as false
            read_reward(f"{name}, lane {lane}", rewards[lane])
        terminated = self._column("terminated", terminated, "b")
        truncated = self._column("truncated", truncated, "b")
        self._shown = self._rows("step", batch)
        self._over = terminated | truncated
        last = self._shown.copy()
        # In SAME_STEP mode the vector has already reset the lanes that ended.
        for lane in np.flatnonzero(self._over & (self._mode is AutoresetMode.SAME_STEP)):
            final = _lane_of(self._space, info["final_obs"], int(lane))
            last[lane] = read_observation(name, "step (final_obs)", self._space, final)
        elapsed = self.advance(chosen, self._over[chosen])
        return Step(
            last[chosen],
            rewards[chosen],
            terminated[chosen],
            truncated[chosen],
            elapsed,
            self._diverged(info)[chosen],
            self._successes(info, chosen),
        )

    def close(self) -> None:
        """See `World.close`."""
        if not self.closed:
            self.closed = True
            self._env.close()

    def _episode_seed(self, lane: int) -> int:
        seed = self._seeds[lane]
        episode = int(self._episodes[lane])
        if episode == 0:
            return seed
        return int(np.random.SeedSequence([seed, episode]).generate_state(1)[0]) & MAX_SEED

    def _reset_inside(self, mask: BoolArray, seeds: Sequence[int | None]) -> FloatArray:
        """Reset the lanes of the mask; at the first call all lanes, because a vector must start as a whole."""
        if self._shown is None:
            mask = np.ones_like(mask)
        given: dict[str, Any] = {"seed": [seed if reset else None for seed, reset in zip(seeds, mask, strict=True)]}
        if not mask.all():
            given["options"] = {"reset_mask": mask.copy()}
        returned = call(self.spec.name, "reset", self._env.reset, **given)
        observations, _ = read_tuple(self.spec.name, "reset", returned, 2)
        shown = self._rows("reset", observations)
        kept = ~mask & self.running
        if self._shown is not None and not np.array_equal(shown[kept], self._shown[kept], equal_nan=True):
            raise PerdureError(
                f"{self.spec.name}: resetting lanes {np.flatnonzero(mask)} changed other lanes. The VectorEnv does "
                "not follow options['reset_mask'], or a wrapper mixes lanes; give its single environments to "
                "GymnasiumWorld."
            )
        self._shown = shown
        self._over = self._over & ~mask
        return shown

    def _column(self, what: str, values: Any, kinds: str) -> Any:
        """Return one value for each lane, of one of NumPy's kinds."""
        array = np.asarray(values)
        if array.shape != (self.num_lanes,) or array.dtype.kind not in kinds:
            allowed = "bools" if kinds == "b" else "real numbers"
            raise PerdureError(
                f"{self.spec.name}: {what} must be {allowed} of shape "
                f"({self.num_lanes},), step returned {array.dtype} of shape {array.shape}"
            )
        return array

    def _rows(self, method: str, batch: Any) -> FloatArray:
        """Return a batch of observations as vectors, shape (num_lanes, observation_size), copied."""
        from gymnasium.spaces import Box
        from gymnasium.vector.utils import iterate

        if not isinstance(self._space, Box):
            lanes = iterate(self._env.observation_space, batch)
            return np.stack([read_observation(self.spec.name, method, self._space, lane) for lane in lanes])
        array = np.asarray(batch)
        shape = (self.num_lanes, *self._space.shape)
        if array.shape != shape or array.dtype.kind not in "fiub":
            raise PerdureError(
                f"{self.spec.name}: {method} must return observations of shape {shape} made of real numbers, it "
                f"returned {array.dtype} of shape {array.shape}"
            )
        return array.astype(np.float64).reshape(self.num_lanes, -1)

    def _diverged(self, info: dict[str, Any]) -> BoolArray:
        """Return which lanes diverged: by their info or, if the environments are in this process, by their engine."""
        found = np.asarray(info.get("diverged", np.zeros(self.num_lanes)), dtype=np.bool_)
        final = info.get("final_info", {})
        if isinstance(final, dict) and "diverged" in final:  # what a lane said before it was reset in the same step
            found = np.where(self._over, np.asarray(final["diverged"], dtype=np.bool_), found)
        here = [divergence_count(env) > 0 for env in getattr(self._env.unwrapped, "envs", ())]
        if here:
            found = found | np.array(here)
        return found

    def _successes(self, info: dict[str, Any], chosen: IntArray) -> FloatArray | None:
        """Return what the infos of these lanes report, see `Step.successes`."""
        from gymnasium.vector import AutoresetMode

        from perdure.wrappers import SUCCESS_KEYS, lane_info, read_success

        final = info.get("final_info")
        if not isinstance(final, dict):
            final = {}
        if self.success_key is None and not {*SUCCESS_KEYS} & {*info, *final}:
            return None
        # In SAME_STEP mode the info of a lane that ended is of its reset; its last one is in final_info.
        renewed = self._over & (self._mode is AutoresetMode.SAME_STEP)
        infos = [lane_info(final if renewed[lane] else info, int(lane)) for lane in chosen]
        return np.array([read_success(self.spec.name, each, self.success_key) for each in infos])


def _lane_of(space: Any, tree: Any, lane: int) -> Any:
    """Return one lane of a batched info entry, which may be nested and contain Gymnasium's masks."""
    from gymnasium.spaces import Dict, Tuple

    if isinstance(space, Dict) and isinstance(tree, dict):
        return {key: _lane_of(part, tree[key], lane) for key, part in space.items()}
    if isinstance(space, Tuple) and isinstance(tree, tuple):
        return tuple(_lane_of(part, branch, lane) for part, branch in zip(space, tree, strict=True))
    return tree[lane]
