"""Random horizons in a single environment."""

from __future__ import annotations

from typing import Any, SupportsFloat, TypeVar

import gymnasium
import numpy as np
from gymnasium.utils import RecordConstructorArgs

from perdure.horizon.distribution import HorizonDistribution
from perdure.horizon.errors import HorizonError
from perdure.horizon.protocol import End
from perdure.horizon.wrappers.limit import check_limit, draw_horizon, horizon_generator

Obs = TypeVar("Obs")
Act = TypeVar("Act")


class HorizonLimit(gymnasium.Wrapper[Obs, Act, Obs, Act], RecordConstructorArgs):
    """Draw a horizon T at every reset and end the episode on step T.

    On that step exactly one flag is true: ``terminated`` if the task itself ended there or ``end="terminated"``
    (nothing follows: the learner must not bootstrap), else ``truncated`` (it bootstraps the last observation).

    T comes from a separate random stream, seeded through ``reset(seed=...)``: same seed, same horizons, and the
    environment's own numbers stay what they are without the wrapper.
    """

    horizon: float
    """T of the running episode, in steps."""
    elapsed: int
    """Steps since reset."""

    def __init__(self, env: gymnasium.Env[Obs, Act], distribution: HorizonDistribution, end: End) -> None:
        """Wrap an environment without a shorter step limit.

        Args:
            env: For one made by Gymnasium, ``gymnasium.make(name, max_episode_steps=-1)`` has no limit.
            distribution: Distribution of T.
            end: What reaching T means.

        Raises:
            HorizonError: If distribution or end are invalid, or the environment's own TimeLimit is shorter than the
                longest T.
        """
        check_limit(env, distribution, end)
        RecordConstructorArgs.__init__(self, distribution=distribution, end=end)
        super().__init__(env)
        self.distribution, self.end = distribution, end
        self.horizon, self.elapsed = 0.0, 0
        self._generator: np.random.Generator | None = None

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Obs, dict[str, Any]]:
        """Start an episode with a new horizon.

        Args:
            seed: Restarts the horizons' random numbers and those of the environment; None lets them run on.
            options: Handed on.
        """
        observation, info = self.env.reset(seed=seed, options=options)
        if self._generator is None or seed is not None:
            self._generator = horizon_generator(seed)
        self.horizon, self.elapsed = draw_horizon(self.distribution, self._generator), 0
        return observation, info

    def step(self, action: Act) -> tuple[Obs, SupportsFloat, bool, bool, dict[str, Any]]:
        """Make one step; on step T one of the two flags is set.

        Args:
            action: Handed on.

        Raises:
            HorizonError: If there was no reset yet.
        """
        if self._generator is None:
            raise HorizonError("reset the environment before the first step: its horizon is drawn there")
        observation, reward, terminated, truncated, info = self.env.step(action)
        self.elapsed += 1
        if self.elapsed >= self.horizon:
            terminated = bool(terminated) or self.end == "terminated"
            truncated = not terminated
        return observation, reward, terminated, truncated, info
