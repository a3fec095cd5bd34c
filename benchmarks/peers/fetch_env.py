"""How fast gymnasium-robotics' FetchPickAndPlace-v4 runs, in an environment of its own: prints one JSON line."""

from __future__ import annotations

import json
import time

import gymnasium
import gymnasium_robotics
import numpy as np

gymnasium.register_envs(gymnasium_robotics)
env = gymnasium.make("FetchPickAndPlace-v4")
actions = np.random.default_rng(0).uniform(-1.0, 1.0, (500, *env.action_space.shape)).astype(np.float32)
rates = []
for _ in range(5):
    env.reset(seed=0)
    spent = 0.0
    for action in actions:
        began = time.perf_counter()
        _, _, terminated, truncated, _ = env.step(action)
        spent += time.perf_counter() - began
        if terminated or truncated:
            env.reset()
    rates.append(len(actions) / spent)
print(json.dumps({"simulated_per_second": max(rates) * float(env.unwrapped.dt)}))
