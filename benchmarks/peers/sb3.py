"""Stable-Baselines3's side of the benchmarks, in an environment that does not have perdure installed.

Usage: python sb3.py train|evaluate CONFIG       (JSON; prints one JSON line)

train       PPO: steps a second inside PPO.learn, and with the form "envpool" the training episodes
evaluate    steps a second of ``evaluate_policy`` in its fastest vectorized form

The configuration is written by the caller from perdure's own presets, so both sides read the same numbers.
"""

from __future__ import annotations

import json
import sys
import time
from functools import partial
from typing import Any

import envpool
import gymnasium
import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv, VecEnv, VecNormalize

SETTINGS = ("learning_rate", "n_steps", "batch_size", "n_epochs", "gamma", "gae_lambda", "clip_range", "ent_coef",
            "vf_coef", "max_grad_norm", "seed")  # fmt: skip
NO_LIMIT = 1_000_000_000
"""EnvPool's own limit is put out of reach: this adapter keeps the horizon, so a fall on the limit step stays a fall."""


class EnvPoolVecEnv(VecEnv):
    """EnvPool behind SB3's contract: same-step reset, ``terminal_observation`` and ``TimeLimit.truncated`` set."""

    def __init__(self, task: str, num_envs: int, seed: int, horizon: int, threads: int = 1) -> None:
        self.pool = envpool.make(
            task, env_type="gymnasium", num_envs=num_envs, num_threads=threads, seed=seed, max_episode_steps=NO_LIMIT
        )
        self.horizon = horizon
        self.elapsed = np.zeros(num_envs, dtype=np.int64)
        self.returns = np.zeros(num_envs)
        self.steps = 0
        self.episodes: list[tuple[int, float, int]] = []
        box = self.pool.observation_space
        action_space = spaces.Box(-1.0, 1.0, self.pool.action_space.shape, np.float32)
        action_space.low[:] = self.pool.action_space.low
        action_space.high[:] = self.pool.action_space.high
        super().__init__(num_envs, spaces.Box(-np.inf, np.inf, box.shape, np.float64), action_space)

    def reset(self) -> np.ndarray:
        self.elapsed[:] = 0
        self.returns[:] = 0
        return self.pool.reset()[0]

    def step_async(self, actions: np.ndarray) -> None:
        self.actions = actions.astype(np.float64)

    def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        observations, rewards, terminated, _, _ = self.pool.step(self.actions)
        self.elapsed += 1
        self.returns += rewards
        self.steps += self.num_envs
        horizon_end = self.elapsed >= self.horizon
        dones = terminated | horizon_end
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        if dones.any():
            lanes = np.flatnonzero(dones)
            observations = observations.copy()
            for lane in lanes:
                truncated = bool(horizon_end[lane] and not terminated[lane])
                infos[lane] = {"terminal_observation": observations[lane].copy(), "TimeLimit.truncated": truncated}
                self.episodes.append((self.steps, float(self.returns[lane]), int(self.elapsed[lane])))
            observations[lanes] = self.pool.reset(lanes)[0]
            self.elapsed[lanes] = 0
            self.returns[lanes] = 0
        return observations, rewards, dones, infos

    def close(self) -> None:
        self.pool.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        return [getattr(self, attr_name, None)] * self.num_envs

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        raise NotImplementedError

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
        raise NotImplementedError

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        return [False] * self.num_envs


def make_model(config: dict[str, Any], env: VecEnv) -> tuple[PPO, VecNormalize]:
    """PPO and its normalizer from one flat configuration."""
    normalized = VecNormalize(env, gamma=config["normalizer_gamma"])
    activation = {"relu": torch.nn.ReLU, "tanh": torch.nn.Tanh}[config["activation"]]
    hidden = list(config["hidden_sizes"])
    model = PPO(
        "MlpPolicy",
        normalized,
        **{name: config[name] for name in SETTINGS},
        policy_kwargs={
            "net_arch": {"pi": hidden, "vf": hidden},
            "activation_fn": activation,
            "log_std_init": config["log_std_init"],
            "ortho_init": config["ortho_init"],
        },
        device="cpu",
    )
    return model, normalized


class Clock(BaseCallback):
    """Time from the end of the first iteration on, so that neither side's start-up is counted."""

    def __init__(self) -> None:
        super().__init__()
        self.marks: list[tuple[int, float]] = []

    def _on_rollout_start(self) -> None:
        self.marks.append((self.num_timesteps, time.perf_counter()))

    def _on_step(self) -> bool:
        return True


def train(config: dict[str, Any]) -> dict[str, Any]:
    task, count, horizon = (config[name] for name in ("task", "n_envs", "horizon"))
    if config["form"] == "envpool":
        env: Any = EnvPoolVecEnv(task, count, config["seed"], horizon)
    else:
        env = DummyVecEnv([partial(gymnasium.make, task.replace("-v3", "-v4"), max_episode_steps=horizon)] * count)
    model, _ = make_model(config, env)
    clock = Clock()
    model.learn(config["total_steps"], callback=clock)
    clock.marks.append((model.num_timesteps, time.perf_counter()))
    first, began = clock.marks[1]
    last, ended = clock.marks[-1]
    return {"steps_per_second": (last - first) / (ended - began), "episodes": getattr(env, "episodes", [])}


def rate(model: Any, normalized: VecNormalize, venv: VecEnv, episodes: int) -> float:
    """Environment steps a second of ``evaluate_policy``."""
    env = VecNormalize(venv, training=False, norm_reward=False)
    env.obs_rms = normalized.obs_rms
    began = time.perf_counter()
    _, lengths = evaluate_policy(model, env, n_eval_episodes=episodes, return_episode_rewards=True, warn=False)
    seconds = time.perf_counter() - began
    env.close()
    return sum(lengths) / seconds


def evaluate(config: dict[str, Any]) -> dict[str, float]:
    """The weights do not matter for a speed. A falling robot resets more often; HalfCheetah never falls."""
    task = config["task"]
    cores = config["cores"]
    lanes = 48
    model, normalized = make_model(config, EnvPoolVecEnv(task, 1, 0, 1000))

    def single() -> Any:
        return Monitor(gymnasium.make(task.replace("-v3", "-v4")))

    subprocesses = rate(model, normalized, SubprocVecEnv([single] * 2 * cores), 4 * cores)
    pool = rate(model, normalized, EnvPoolVecEnv(task, lanes, 0, 1000, threads=cores), lanes)
    return {"steps_per_second": max(subprocesses, pool)}


def main() -> None:
    what, config = sys.argv[1:]
    torch.set_num_threads(1)
    print(json.dumps({"train": train, "evaluate": evaluate}[what](json.loads(config))))


if __name__ == "__main__":
    main()
