"""Random horizons in a vector environment."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from numpy.typing import NDArray

from perdure.horizon.distribution import HorizonDistribution
from perdure.horizon.errors import HorizonError
from perdure.horizon.protocol import End
from perdure.horizon.wrappers.any_vector_wrapper import AnyVectorWrapper
from perdure.horizon.wrappers.lane_infos import (
    forget_lane,
    lane_info,
    lane_observation,
    replace_lanes,
    replace_unmasked,
)
from perdure.horizon.wrappers.limit import check_limit, draw_horizon, horizon_generator
from perdure.horizon.wrappers.step_counter import StepCounter, autoreset_mode, reset_lanes

StepResult = tuple[Any, NDArray[Any], NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]


class VectorHorizonLimit(AnyVectorWrapper):
    """:class:`HorizonLimit` for every lane of a vector environment, in its own autoreset mode.

    Put it directly above the vector environment: it resets single lanes through ``options={"reset_mask": ...}``, which
    Gymnasium's Sync- and AsyncVectorEnv and EnvPool (1.2.2 and later) understand. One that ignores the mask is found
    out at the first reset and refused.

    * ``NEXT_STEP``: the step after step T resets the lane (reward 0, action ignored), as Gymnasium does after a fall.
      The world below has been stepped once more by then; nothing of that step is shown.
    * ``SAME_STEP``: step T resets the lane; ``infos`` holds ``final_obs`` and ``final_info``.
    * ``DISABLED``: the user resets with ``reset_mask``; stepping an ended lane raises HorizonError.

    Lane i draws its horizons as a HorizonLimit that was reset with its seed would.
    """

    horizons: NDArray[np.float64]
    """T of the running episodes, in steps, shape (n,)."""
    last_horizons: NDArray[np.float64]
    """T of the episodes that the last step belonged to, shape (n,): before the resets of SAME_STEP."""

    def __init__(self, env: VectorEnv[Any, Any, Any], distribution: HorizonDistribution, end: End) -> None:
        """Wrap a vector environment without a shorter step limit.

        Args:
            env: The vector environment.
            distribution: Distribution of T.
            end: What reaching T means.

        Raises:
            HorizonError: If distribution or end are invalid, the environment's own limit is shorter than the longest T,
                or it does not say its autoreset mode.
        """
        super().__init__(env)
        check_limit(env, distribution, end)
        self.distribution, self.end = distribution, end
        self.horizons = np.zeros(self.num_envs)
        self.last_horizons = np.zeros(self.num_envs)
        self._counter = StepCounter(self.num_envs, autoreset_mode(env))
        self._cut = np.zeros(self.num_envs, np.bool_)  # ended by us alone: the world below runs on
        self._generators = [horizon_generator(None) for _ in range(self.num_envs)]

    @property
    def elapsed(self) -> NDArray[np.int64]:
        """Steps since reset, shape (n,)."""
        return self._counter.elapsed

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start episodes with new horizons, in all lanes or those of ``options["reset_mask"]``.

        Args:
            seed: Restarts the horizons' random numbers and those of the environments: lane i gets seed + i, or seed[i].
            options: Handed on.
        """
        # A copy, because Gymnasium removes the mask from the dictionary it is given.
        observations, infos = self.env.reset(seed=seed, options=None if options is None else dict(options))  # type: ignore[arg-type]
        lanes = reset_lanes(self.num_envs, options)
        seeds = [seed + i for i in range(self.num_envs)] if isinstance(seed, int | np.integer) else seed
        for lane in np.flatnonzero(lanes).tolist():
            if seeds is not None and seeds[lane] is not None:
                self._generators[lane] = horizon_generator(seeds[lane])
        self._counter.reset(lanes)
        self._draw(lanes)
        return observations, infos

    def step(self, actions: Any) -> StepResult:
        """Make one step of all lanes; on step T of a lane one of its two flags is set.

        Args:
            actions: Handed on.

        Raises:
            HorizonError: If a lane has never been reset, or has ended and must be reset by the user (DISABLED).
        """
        if not self.horizons.all():
            raise HorizonError("reset the vector environment before the first step: its horizons are drawn there")
        restarted = self._counter.advance()
        result = self._restart(restarted & self._cut, self.env.step(actions))
        self._draw(restarted)
        return self._finish(*self._limit(*result))

    def _restart(self, lanes: NDArray[np.bool_], result: StepResult) -> StepResult:
        """Reset ended lanes in NEXT_STEP mode, because the wrapped environment has stepped them."""
        if not lanes.any():
            return result
        observations, rewards, terminated, truncated, infos = result
        observations, infos = self._reset_below(lanes, observations, infos)
        return observations, np.where(lanes, 0, rewards), terminated & ~lanes, truncated & ~lanes, infos

    def _limit(self, observations: Any, rewards: Any, terminated: Any, truncated: Any, infos: Any) -> StepResult:
        """Set the flags of the lanes on their last step."""
        on_limit = self._counter.elapsed >= self.horizons
        self._cut = on_limit & ~(terminated | truncated)
        terminated = terminated | (on_limit & (self.end == "terminated"))
        truncated = np.where(on_limit, ~terminated, truncated)
        return observations, rewards, terminated, truncated, infos

    def _finish(self, observations: Any, rewards: Any, terminated: Any, truncated: Any, infos: Any) -> StepResult:
        """Reset ended lanes in SAME_STEP mode, and keep their final observations."""
        self.last_horizons = self.horizons.copy()
        restarted = self._counter.end(terminated | truncated)
        lanes = restarted & self._cut
        if lanes.any():
            for lane in np.flatnonzero(lanes).tolist():
                last = lane_observation(self.env.observation_space, observations, lane)
                final = {"final_obs": last, "final_info": lane_info(infos, lane)}
                forget_lane(infos, lane)
                infos = self._add_info(infos, final, lane)
            observations, infos = self._reset_below(lanes, observations, infos)
        self._draw(restarted)
        return observations, rewards, terminated, truncated, infos

    def _reset_below(self, lanes: NDArray[np.bool_], observations: Any, infos: Any) -> tuple[Any, dict[str, Any]]:
        fresh, fresh_infos = self.env.reset(options={"reset_mask": lanes.copy()})
        replace_unmasked(infos, fresh_infos, lanes)
        for lane in np.flatnonzero(lanes).tolist():
            if self._counter.mode is AutoresetMode.NEXT_STEP:
                forget_lane(infos, lane)
            infos = self._add_info(infos, lane_info(fresh_infos, lane), lane)
        return replace_lanes(observations, fresh, lanes), infos

    def _draw(self, lanes: NDArray[np.bool_]) -> None:
        for lane in np.flatnonzero(lanes).tolist():
            self.horizons[lane] = draw_horizon(self.distribution, self._generators[lane])
