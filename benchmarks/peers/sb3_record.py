"""Record one iteration of Stable-Baselines3's PPO: the rollout, the minibatch order, and the weights before and after.

Usage: python sb3_record.py OUT.safetensors

Run with the peer's environment. tests/learn/test_sb3_parity.py feeds the same rollout to perdure's learner.
"""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
import torch
from safetensors.numpy import save_file
from sb3 import EnvPoolVecEnv, make_model
from stable_baselines3.common.vec_env import VecEnvWrapper

CONFIG: dict[str, Any] = {
    "task": "Hopper-v3",
    "seed": 3,
    "n_envs": 2,
    "horizon": 25,
    "n_steps": 128,
    "batch_size": 64,
    "n_epochs": 3,
    "gamma": 0.99,
    "normalizer_gamma": 0.98,
    "gae_lambda": 0.95,
    "learning_rate": 1e-3,
    "ent_coef": 0.01,
    "clip_range": 0.1,
    "max_grad_norm": 0.5,
    "vf_coef": 0.7,
    "hidden_sizes": [32, 32],
    "activation": "tanh",
    "log_std_init": -0.5,
    "ortho_init": True,
    "total_steps": 256,
}


class Recorder(VecEnvWrapper):
    """Keeps what passes between the raw environment and the normalizer."""

    def __init__(self, venv: EnvPoolVecEnv) -> None:
        super().__init__(venv)
        self.log: dict[str, list[np.ndarray]] = {
            name: [] for name in ("observations", "rewards", "dones", "truncated", "last")
        }

    def reset(self) -> np.ndarray:
        observations = self.venv.reset()
        self.log["observations"].append(observations.copy())
        return observations

    def step_wait(self) -> Any:
        observations, rewards, dones, infos = self.venv.step_wait()
        self.log["observations"].append(observations.copy())
        self.log["rewards"].append(rewards.copy())
        self.log["dones"].append(dones.copy())
        self.log["truncated"].append(np.array([i.get("TimeLimit.truncated", False) for i in infos]))
        self.log["last"].append(np.stack([i.get("terminal_observation", observations[k]) for k, i in enumerate(infos)]))
        return observations, rewards, dones, infos


def weights(model: Any, prefix: str) -> dict[str, np.ndarray]:
    state = model.policy.state_dict()
    names = {
        "mlp_extractor.policy_net.0": "policy.0",
        "mlp_extractor.policy_net.2": "policy.1",
        "action_net": "policy.2",
        "mlp_extractor.value_net.0": "value.0",
        "mlp_extractor.value_net.2": "value.1",
        "value_net": "value.2",
    }
    out = {f"{prefix}/log_std": state["log_std"].numpy().copy()}
    for theirs, ours in names.items():
        out[f"{prefix}/{ours}.weight"] = np.ascontiguousarray(state[f"{theirs}.weight"].numpy().T).copy()
        out[f"{prefix}/{ours}.bias"] = state[f"{theirs}.bias"].numpy().copy()
    return out


def main() -> None:
    torch.set_num_threads(1)
    recorder = Recorder(EnvPoolVecEnv(CONFIG["task"], CONFIG["n_envs"], CONFIG["seed"], CONFIG["horizon"]))
    model, normalized = make_model(CONFIG, recorder)
    arrays = weights(model, "before")
    orders: list[np.ndarray] = []
    permutation = np.random.permutation

    def recorded(n: int) -> np.ndarray:
        orders.append(permutation(n))
        return orders[-1]

    np.random.permutation = recorded
    model.learn(CONFIG["total_steps"])
    buffer = model.rollout_buffer
    # After learning SB3 has flattened its buffer environment by environment: row = env * n_steps + step.
    flat = {"observations": buffer.observations, "actions": buffer.actions, "values": buffer.values}
    flat |= {"log_probs": buffer.log_probs, "advantages": buffer.advantages, "returns": buffer.returns}
    arrays |= {f"buffer/{name}": np.ascontiguousarray(value) for name, value in flat.items()}
    arrays |= {f"raw/{name}": np.ascontiguousarray(np.stack(rows)) for name, rows in recorder.log.items()}
    arrays |= weights(model, "after")
    arrays["orders"] = np.stack(orders)
    for name, rms in (("observation", normalized.obs_rms), ("return", normalized.ret_rms)):
        arrays[f"{name}.mean"] = np.atleast_1d(rms.mean)
        arrays[f"{name}.var"] = np.atleast_1d(rms.var)
        arrays[f"{name}.count"] = np.atleast_1d(np.float64(rms.count))
    arrays = {k: v.astype(np.uint8) if v.dtype == bool else np.ascontiguousarray(v) for k, v in arrays.items()}
    save_file(arrays, sys.argv[1])


if __name__ == "__main__":
    main()
