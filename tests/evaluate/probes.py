"""Gymnasium environments whose every return is known beforehand."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from gymnasium.spaces import Box, Dict, Discrete, MultiDiscrete


class Falling(gymnasium.Env):
    """Falls after a number of steps that its start state shows; each step pays the action plus the step's number.

    Observation: [steps it may last / 100, steps made / 100]. Lasts 5 to 60 steps, drawn at reset.
    """

    observation_space = Box(-1.0, 1.0, (2,), np.float64)
    action_space = Box(-1.0, 1.0, (1,), np.float64)

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        self.lasts, self.steps = int(self.np_random.integers(5, 61)), 0
        return self._see(), {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        self.steps += 1
        return self._see(), float(action[0]) + self.steps, self.steps >= self.lasts, False, {}

    def _see(self) -> Any:
        return np.array([self.lasts / 100, self.steps / 100])


class Cue(gymnasium.Env):
    """Shows a number once, at the start; pays 1 for each action that names it. Falls after 20 steps for cue 0."""

    observation_space = Box(-1.0, 4.0, (1,), np.float32)
    action_space = Discrete(4)

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        self.cue, self.steps = int(self.np_random.integers(4)), 0
        return np.array([self.cue], np.float32), {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        assert self.action_space.contains(action)
        self.steps += 1
        return np.array([-1.0], np.float32), float(action == self.cue), self.cue == 0 and self.steps >= 20, False, {}


class Dial(gymnasium.Env):
    """A dial with a pointer, 3 to 5; pays 1 for the action that equals the pointer, which moves on at each step."""

    observation_space = Dict(
        {"pointer": Discrete(3, start=3), "grid": Box(0, 255, (2, 3), np.uint8), "pair": MultiDiscrete([2, 3])}
    )
    action_space = Discrete(3, start=3)

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        self.pointer = int(self.np_random.integers(3))
        return self._see(), {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        assert self.action_space.contains(action)
        reward = float(action == self.pointer + 3)
        self.pointer = (self.pointer + 1) % 3
        return self._see(), reward, False, False, {}

    def _see(self) -> Any:
        grid = np.arange(6, dtype=np.uint8).reshape(2, 3) + self.pointer
        return {"pointer": np.int64(self.pointer + 3), "grid": grid, "pair": np.array([1, self.pointer])}


class Reach(gymnasium.Env):
    """A point moves by at most 0.1 a step to a goal 0.3 to 1.2 away, which it can therefore reach after 3 to 12 steps.

    Observation and info are those of Gymnasium-Robotics' FetchReach. Reward: minus the distance, or minus 1 until the
    goal is reached. The episode ends at the goal, is cut after some steps, is said to terminate there, or goes on.
    """

    def __init__(
        self,
        ends: bool = True,
        cut_after: float = np.inf,
        falls_after: float = np.inf,
        sparse: bool = True,
        key: str = "is_success",
    ) -> None:
        self.ends, self.cut_after, self.falls_after, self.sparse, self.key = ends, cut_after, falls_after, sparse, key
        place = Box(-np.inf, np.inf, (1,), np.float64)
        self.observation_space = Dict({"observation": place, "achieved_goal": place, "desired_goal": place})
        self.action_space = Box(-1.0, 1.0, (1,), np.float32)

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        self.place, self.goal, self.steps = np.zeros(1), np.array([0.1 * self.np_random.integers(3, 13)]), 0
        return self._see(), {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        self.steps += 1
        self.place = self.place + 0.1 * np.clip(action, -1.0, 1.0)
        away = float(np.abs(self.goal - self.place)[0])
        success = np.float32(away < 0.05)
        terminated = bool(self.ends and success) or self.steps >= self.falls_after
        reward = success - 1.0 if self.sparse else -away
        return self._see(), float(reward), terminated, self.steps >= self.cut_after, {self.key: success}

    def _see(self) -> Any:
        return {"observation": self.place.copy(), "achieved_goal": self.place.copy(), "desired_goal": self.goal.copy()}


class Walkway(gymnasium.Env):
    """Pays the action at each step. Falls at step 150 if the action was then above what the ground allows.

    The ground, drawn at reset and observed, allows an action of 1 with a chance of one half, otherwise 0.9.
    """

    observation_space = Box(0.0, 1.0, (1,), np.float64)
    action_space = Box(-1.0, 1.0, (1,), np.float64)

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        self.allowed, self.steps = float(self.np_random.choice([0.9, 1.0])), 0
        return np.array([self.allowed]), {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        self.steps += 1
        falls = self.steps == 150 and float(action[0]) > self.allowed
        return np.array([self.allowed]), float(action[0]), falls, False, {}
