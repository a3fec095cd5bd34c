"""A Gymnasium environment whose every number is known beforehand."""

from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np


class Counting(gymnasium.Env):
    """Counts its steps.

    Observation: [start, steps], where start is drawn from the seeded generator at reset. Reward of step k under action
    a: 10 k + a. It ends by itself after `falls_after` steps; as a dictionary observation it is {"start", "steps"}.
    With `one_memory` every observation is the same array, overwritten: a world that keeps it is caught. (Gymnasium's
    own SyncVectorEnv keeps it, in `final_obs`.)
    """

    def __init__(self, falls_after: float = np.inf, as_dict: bool = False, one_memory: bool = False) -> None:
        self.falls_after, self.as_dict, self.one_memory = falls_after, as_dict, one_memory
        box = gymnasium.spaces.Box(-np.inf, np.inf, (1,), np.float64)
        whole = gymnasium.spaces.Box(-np.inf, np.inf, (2,), np.float64)
        self.observation_space = gymnasium.spaces.Dict({"start": box, "steps": box}) if as_dict else whole
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (1,), np.float32)
        self.start, self.steps, self.resets = 0.0, 0, 0
        self.shown = np.zeros(2)

    def _observation(self) -> Any:
        if self.as_dict:
            return {"start": np.array([self.start]), "steps": np.array([float(self.steps)])}
        self.shown[:] = self.start, self.steps
        return self.shown if self.one_memory else self.shown.copy()

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        self.start, self.steps = float(self.np_random.integers(1_000_000)), 0
        self.resets += 1
        return self._observation(), {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        self.steps += 1
        fell = self.steps >= self.falls_after
        return self._observation(), 10.0 * self.steps + float(action[0]), fell, False, {}


def first_starts(seed: int, count: int) -> list[float]:
    """The starts of the first episodes after seeding, drawn from Gymnasium's own generator."""
    generator, _ = gymnasium.utils.seeding.np_random(seed)
    return [float(generator.integers(1_000_000)) for _ in range(count)]


def factories(count: int, **options: Any) -> list[Callable[[], Counting]]:
    """As many functions that build a counting environment."""
    return [lambda: Counting(**options)] * count
