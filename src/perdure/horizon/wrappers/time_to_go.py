"""Time-to-go observation of a single environment."""

from __future__ import annotations

from typing import Any, SupportsFloat

import gymnasium
import numpy as np
from gymnasium.utils import RecordConstructorArgs

from perdure.horizon.clock import Clock
from perdure.horizon.embedding import Embedding
from perdure.horizon.errors import HorizonError
from perdure.horizon.wrappers.appended import append, appended_space
from perdure.horizon.wrappers.horizon_limit import HorizonLimit


class TimeToGoObservation(gymnasium.Wrapper[Any, Any, Any, Any], RecordConstructorArgs):
    """Append phi(t, T) to the observation.

    In training (t, T) come from the :class:`HorizonLimit` below. At deployment they come from a clock:
    ``TimeToGoObservation(env, Geometric(10), clock=Constant(500))``.

    The last observation of an episode contains phi(T, T): no steps left.
    """

    def __init__(
        self,
        env: gymnasium.Env[Any, Any],
        embedding: Embedding,
        clock: Clock | None = None,
        dict: bool = False,
    ) -> None:
        """Wrap an environment.

        Args:
            env: Contains a :class:`HorizonLimit`, unless a clock is given.
            embedding: phi.
            clock: Sets the time-to-go at deployment; None: the time-to-go of the training horizon.
            dict: Observations are {"observation", "time_to_go"} instead of one flat vector, so that a normalizer can
                leave phi out (Stable-Baselines3: ``VecNormalize(norm_obs_keys=["observation"])``).

        Raises:
            HorizonError: If there is neither a clock nor a HorizonLimit, or phi cannot be appended to the observations.
        """
        RecordConstructorArgs.__init__(self, embedding=embedding, clock=clock, dict=dict)
        super().__init__(env)
        self.embedding, self.clock = embedding, clock
        self._limit = find_limit(env) if clock is None else None
        self._elapsed = 0
        self.observation_space = appended_space(env.observation_space, embedding.size, as_dict=dict)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Start an episode at t = 0.

        Args:
            seed: Handed on.
            options: Handed on.
        """
        observation, info = self.env.reset(seed=seed, options=options)
        self._elapsed = 0
        return self._append(observation), info

    def step(self, action: Any) -> tuple[Any, SupportsFloat, bool, bool, dict[str, Any]]:
        """Make one step.

        Args:
            action: Handed on.
        """
        observation, reward, terminated, truncated, info = self.env.step(action)
        self._elapsed += 1
        return self._append(observation), reward, terminated, truncated, info

    def _append(self, observation: Any) -> Any:
        if self.clock is not None:
            time = self.clock.time(np.float64(self._elapsed))
        else:
            assert self._limit is not None
            time = np.float64(self._limit.elapsed), self._limit.horizon
        return append(self.observation_space, observation, np.asarray(self.embedding(*time)))


def find_limit(env: gymnasium.Env[Any, Any]) -> HorizonLimit[Any, Any]:
    """Return the HorizonLimit among the wrapped environments.

    Args:
        env: A stack of wrappers.

    Raises:
        HorizonError: If there is none.
    """
    layer = env
    while isinstance(layer, gymnasium.Wrapper):
        if isinstance(layer, HorizonLimit):
            return layer
        layer = layer.env
    raise HorizonError(f"the time-to-go needs a HorizonLimit below it, or a clock; {env} has neither")
