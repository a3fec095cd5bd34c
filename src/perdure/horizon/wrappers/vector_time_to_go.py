"""Time-to-go observation of a vector environment."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium.vector import VectorEnv, VectorWrapper
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from perdure.horizon.clock import Clock
from perdure.horizon.embedding import Embedding
from perdure.horizon.errors import HorizonError
from perdure.horizon.lane_clocks import LaneClocks
from perdure.horizon.wrappers.any_vector_wrapper import AnyVectorWrapper
from perdure.horizon.wrappers.appended import append, appended_space
from perdure.horizon.wrappers.step_counter import StepCounter, autoreset_mode, reset_lanes
from perdure.horizon.wrappers.vector_horizon_limit import StepResult, VectorHorizonLimit


class VectorTimeToGoObservation(AnyVectorWrapper):
    """:class:`TimeToGoObservation` for every lane of a vector environment, in its own autoreset mode.

    In ``SAME_STEP`` mode phi is appended to ``infos["final_obs"]`` too.
    """

    def __init__(
        self,
        env: VectorEnv[Any, Any, Any],
        embedding: Embedding,
        clock: Clock | LaneClocks | None = None,
        dict: bool = False,
    ) -> None:
        """Wrap a vector environment.

        Args:
            env: With a :class:`VectorHorizonLimit` somewhere beneath, unless a clock is given.
            embedding: phi.
            clock: Sets the time-to-go at deployment, one clock for all lanes or one for each; None: the time-to-go of
                the training horizons.
            dict: Observations are {"observation", "time_to_go"} instead of one flat vector.

        Raises:
            HorizonError: If there is neither a clock nor a VectorHorizonLimit, there are more or fewer clocks than
                lanes, phi cannot be appended to the observations, or the environment does not say its autoreset mode.
        """
        super().__init__(env)
        if isinstance(clock, LaneClocks) and len(clock.clocks) != self.num_envs:
            raise HorizonError(f"{self.num_envs} lanes need as many clocks, got {len(clock.clocks)}")
        self.embedding, self.clock = embedding, clock
        self._limit = find_limit(env) if clock is None else None
        self._counter = StepCounter(self.num_envs, autoreset_mode(env))
        self.single_observation_space = appended_space(env.single_observation_space, embedding.size, as_dict=dict)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start episodes at t = 0, in all lanes or those of ``options["reset_mask"]``.

        Args:
            seed: Handed on.
            options: Handed on.
        """
        lanes = reset_lanes(self.num_envs, options)
        # A copy, because Gymnasium removes the mask from the dictionary it is given.
        below = None if options is None else {**options}
        observations, infos = self.env.reset(seed=seed, options=below)  # type: ignore[arg-type]
        self._counter.reset(lanes)
        return append(self.observation_space, observations, self._phi()), infos

    def step(self, actions: Any) -> StepResult:
        """Make one step of all lanes.

        Args:
            actions: Handed on.

        Raises:
            HorizonError: If a lane has ended and must be reset by the user (DISABLED).
        """
        self._counter.advance()
        observations, rewards, terminated, truncated, infos = self.env.step(actions)
        if "final_obs" in infos:
            infos = {**infos, "final_obs": self._append_final(infos["final_obs"])}
        self._counter.end(terminated | truncated)
        return append(self.observation_space, observations, self._phi()), rewards, terminated, truncated, infos

    def _phi(self, ended: bool = False) -> NDArray[np.float64]:
        elapsed = self._counter.elapsed.astype(np.float64)
        if self.clock is not None:
            time = self.clock.time(elapsed)
        else:
            assert self._limit is not None
            time = elapsed, self._limit.last_horizons if ended else self._limit.horizons
        return np.asarray(self.embedding(*time))

    def _append_final(self, final: Any) -> Any:
        phi = self._phi(ended=True)
        if final.dtype != object:
            return append(self.observation_space, final, phi)
        space = self.single_observation_space
        appended = np.full(final.shape, None, dtype=object)
        for lane, observation in enumerate(final):
            if observation is not None:
                appended[lane] = append(space, observation, phi[lane])
        return appended


def find_limit(env: VectorEnv[Any, Any, Any]) -> VectorHorizonLimit:
    """Return the VectorHorizonLimit among the wrapped environments.

    Args:
        env: A stack of vector wrappers.

    Raises:
        HorizonError: If there is none.
    """
    layer = env
    while isinstance(layer, VectorWrapper):
        if isinstance(layer, VectorHorizonLimit):
            return layer
        layer = layer.env
    raise HorizonError(f"the time-to-go needs a VectorHorizonLimit below it, or a clock; {env} has neither")
