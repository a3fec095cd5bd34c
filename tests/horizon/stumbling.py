"""A world that counts its steps and stumbles when it is told to."""

from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np


class Stumbling(gymnasium.Env):
    """Observation [start, steps], start drawn in [0, 1) by the world's own generator at reset.

    Episode number e terminates on step `falls[e]` and is truncated by the world itself on step `cuts[e]`; later
    episodes do neither. Reward: steps so far. Info: {"steps": ...}, at reset {"start": ...}.
    """

    def __init__(self, falls: Sequence[float] = (), cuts: Sequence[float] = (), as_dict: bool = False) -> None:
        self.falls, self.cuts, self.as_dict = list(falls), list(cuts), as_dict
        box = gymnasium.spaces.Box(-np.inf, np.inf, (2,), np.float64)
        self.observation_space = gymnasium.spaces.Dict({"body": box}) if as_dict else box
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (1,), np.float32)
        self.episode, self.steps, self.start = -1, 0, 0.0

    def _observation(self) -> Any:
        body = np.array([self.start, self.steps], np.float64)
        return {"body": body} if self.as_dict else body

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        self.start, self.steps, self.episode = self.np_random.random(), 0, self.episode + 1
        return self._observation(), {"start": self.start}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        self.steps += 1
        fell, cut = (self.episode < len(when) and self.steps >= when[self.episode] for when in (self.falls, self.cuts))
        return self._observation(), float(self.steps), fell, cut, {"steps": self.steps}


ACTION = np.zeros(1, np.float32)


def flags(env: gymnasium.Env, count: int) -> list[tuple[int, int]]:
    """(terminated, truncated) of as many steps as 0 and 1; after an end the environment is reset."""
    seen = []
    for _ in range(count):
        _, _, terminated, truncated, _ = env.step(ACTION)
        seen.append((int(terminated), int(truncated)))
        if terminated or truncated:
            env.reset()
    return seen
