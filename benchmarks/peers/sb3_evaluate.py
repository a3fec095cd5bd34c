"""Speed of Stable-Baselines3's evaluation: as its documentation shows it, and in its fastest vectorised forms.

Usage: python sb3_evaluate.py CONFIG.json OUT.json

The policy has the size of the one perdure evaluates; its weights do not matter for a speed, but a falling robot resets
more often, so the horizon is short enough for that not to decide. HalfCheetah never falls.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from typing import Any

import gymnasium
import torch
from sb3_train import EnvPoolVecEnv, make_model
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv, VecEnv, VecNormalize


def single(task: str) -> Any:
    return Monitor(gymnasium.make(task.replace("-v3", "-v4")))


def rate(model: Any, normalized: VecNormalize, venv: VecEnv, episodes: int) -> float:
    """Environment steps a second of ``evaluate_policy``."""
    env = VecNormalize(venv, training=False, norm_reward=False)
    env.obs_rms = normalized.obs_rms
    began = time.perf_counter()
    _, lengths = evaluate_policy(model, env, n_eval_episodes=episodes, return_episode_rewards=True, warn=False)
    seconds = time.perf_counter() - began
    env.close()
    return sum(lengths) / seconds


def main() -> None:
    config = json.loads(Path(sys.argv[1]).read_text())
    task, cores = config["task"], config["cores"]
    torch.set_num_threads(1)
    model, normalized = make_model(config, EnvPoolVecEnv(task, 1, 0, 1000))
    lanes = 48
    result = {
        "documented": rate(model, normalized, DummyVecEnv([lambda: single(task)]), 4),
        "subprocesses": rate(model, normalized, SubprocVecEnv([lambda: single(task)] * 2 * cores), 4 * cores),
        "envpool": rate(model, normalized, EnvPoolVecEnv(task, lanes, 0, 1000, threads=cores), lanes),
    }
    Path(sys.argv[2]).write_text(json.dumps(result))


if __name__ == "__main__":
    main()
