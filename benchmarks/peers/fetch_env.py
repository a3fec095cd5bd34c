"""How fast gymnasium-robotics' FetchPickAndPlace-v4 runs, in an environment of its own: prints one JSON line."""

from __future__ import annotations

import json
import time

import gymnasium
import gymnasium_robotics
import mujoco
import numpy as np

gymnasium.register_envs(gymnasium_robotics)
env = gymnasium.make("FetchPickAndPlace-v4")
rng = np.random.default_rng(0)
actions = rng.uniform(-1.0, 1.0, (500, *env.action_space.shape)).astype(np.float32)
inner = env.unwrapped
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
print(
    json.dumps(
        {
            "steps_per_second": max(rates),
            "step_s": float(inner.dt),
            "physics_step_s": float(inner.model.opt.timestep),
            "mujoco": mujoco.__version__,
        }
    )
)
