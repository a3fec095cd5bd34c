"""One seed of a slice of the horizon study, written with Stable-Baselines3 as its documentation shows it.

Usage: python sb3_study.py CONFIG.json OUT.json

The same training steps, clocks, start states and test steps as benchmarks/study_slice.py: a wrapper appends the
geometric embedding of the time-to-go, PPO trains in one Gymnasium environment, and ``evaluate_policy`` runs each clock.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import torch
from sb3_train import make_model
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

FACTORS = np.linspace(0.99, 1.0, 10)


class TimeToGo(gymnasium.Wrapper):  # type: ignore[type-arg]
    """Appends FACTORS ** (steps to go): of a random horizon (training), of the test horizon, or a constant."""

    def __init__(self, env: Any, horizon: int | None, constant: int | None = None) -> None:
        super().__init__(env)
        self.horizon, self.constant, self.rng = horizon, constant, np.random.default_rng(0)
        size = env.observation_space.shape[0] + len(FACTORS)
        self.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (size,), np.float64)

    def _observe(self, observation: Any) -> Any:
        to_go = self.length - self.elapsed if self.constant is None else self.constant
        return np.concatenate([observation, FACTORS**to_go])

    def reset(self, **options: Any) -> Any:
        self.length = self.horizon or int(self.rng.integers(200, 1001))
        self.elapsed = 0
        observation, info = self.env.reset(**options)
        return self._observe(observation), info

    def step(self, action: Any) -> Any:
        observation, reward, terminated, truncated, info = self.env.step(action)
        self.elapsed += 1
        ended = self.elapsed >= self.length
        terminated, truncated = terminated or (ended and self.horizon is None), truncated or ended
        return self._observe(observation), reward, terminated, truncated, info


def make(task: str, horizon: int | None = None, constant: int | None = None) -> Any:
    env = gymnasium.make(task.replace("-v3", "-v4"), max_episode_steps=10**9)
    return Monitor(TimeToGo(env, horizon, constant))


def main() -> None:
    config = json.loads(Path(sys.argv[1]).read_text())
    torch.set_num_threads(1)
    began = time.perf_counter()
    task, steps = config["task"], config["test_steps"]
    model, normalized = make_model(config, DummyVecEnv([lambda: make(task)]))
    model.learn(config["total_steps"])
    for constant in (500, None):
        env = VecNormalize(
            DummyVecEnv([lambda constant=constant: make(task, steps, constant)]), training=False, norm_reward=False
        )
        env.obs_rms = normalized.obs_rms
        evaluate_policy(model, env, n_eval_episodes=config["start_states"], warn=False)
    Path(sys.argv[2]).write_text(json.dumps({"seconds": time.perf_counter() - began}))


if __name__ == "__main__":
    main()
