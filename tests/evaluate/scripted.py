"""Worlds whose every number is known beforehand, and a policy that fits them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import gymnasium
import numpy as np

from perdure.envs.gymnasium import GymnasiumWorld
from perdure.evaluate import EpisodeSpec, evaluate_episodes
from perdure.horizon import Constant, Fixed, HorizonProtocol, Linear
from perdure.policy import Normalizer, Policy, TaskInfo


@dataclass(frozen=True)
class Script:
    """What happens in one episode at step 1, 2, ...: reward, place, and when it ends."""

    reward: Callable[[int], float] = lambda step: 1.0
    place: Callable[[int], float] = lambda step: 0.0
    third: float = 0.0
    """Added to the third component of every observation."""
    falls_at: float = np.inf
    cut_at: float = np.inf


class Scripted(gymnasium.Env):
    """Observation: [start, place, a tenth of the action taken]; start is drawn from the seeded generator at reset."""

    def __init__(self, script: Script) -> None:
        self.script, self.steps, self.start = script, 0, 0.0
        self.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (3,), np.float64)
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (1,), np.float64)

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        self.start, self.steps = float(self.np_random.uniform(-0.1, 0.1)), 0
        return np.array([self.start, 0.0, 0.0]), {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        self.steps += 1
        seen = np.array([self.start, self.script.place(self.steps), self.script.third + 0.1 * float(action[0])])
        reward = self.script.reward(self.steps)
        return seen, reward, self.steps >= self.script.falls_at, self.steps >= self.script.cut_at, {}


def world_of(scripts: list[Script], hides_divergence: bool = True) -> GymnasiumWorld:
    world = GymnasiumWorld([lambda s=s: Scripted(s) for s in scripts], list(range(len(scripts))), "scripted")
    world.spec = replace(world.spec, hides_divergence=hides_divergence)
    return world


def policy_for(task: TaskInfo, *, phi: bool = False, std: float = 1.0, seed: int = 0, method: str = "ppo") -> Policy:
    """Random weights; observations vary by ``std`` in what it believes to be its training."""
    rng = np.random.default_rng(seed)
    protocol = HorizonProtocol(Linear() if phi else None, Fixed(1000), "terminated", 0.99, 0.99)
    size = task.observation_size + protocol.embedding_size
    weights = {
        "policy.0.weight": rng.normal(size=(size, task.action_size)).astype(np.float32),
        "policy.0.bias": np.zeros(task.action_size, np.float32),
        "value.0.weight": np.zeros((size, 1), np.float32),
        "value.0.bias": np.zeros(1, np.float32),
        "log_std": np.zeros(task.action_size, np.float32),
    }
    normalizer = Normalizer(np.zeros(task.observation_size), np.full(task.observation_size, std**2))
    clock = Constant(500.0) if phi else None
    return Policy(task, weights, "tanh", normalizer, protocol, clock, {"method": method, "seed": seed})


SCRIPTED = TaskInfo("scripted", 3, (-1.0,), (1.0,))


def evaluate(scripts: list[Script], steps: int, hides_divergence: bool = True) -> Any:
    """Records of one episode for each script."""
    episodes = [EpisodeSpec(0, None, seed, steps=steps) for seed in range(len(scripts))]
    return evaluate_episodes([policy_for(SCRIPTED)], episodes, world=world_of(scripts, hides_divergence))
