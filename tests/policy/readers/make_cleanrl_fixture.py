"""Write a model as CleanRL's `ppo_continuous_action` saves it, and its actions, as truth for the tests of the reader.

    python tests/policy/readers/make_cleanrl_fixture.py tests/policy/readers/fixtures

Needs PyTorch, which perdure itself does not. The module has the shapes and names of CleanRL's Agent; its weights are
random, the statistics are those of Gymnasium's NormalizeObservation after some steps on Pendulum-v1.
"""

import sys
from pathlib import Path

import gymnasium
import numpy as np
import torch
from torch import nn


class Agent(nn.Module):
    """Critic and actor of 64 x 64 tanh units, and a standard deviation that does not depend on the state."""

    def __init__(self, size, actions):
        super().__init__()

        def network(outputs):
            return nn.Sequential(nn.Linear(size, 64), nn.Tanh(), nn.Linear(64, 64), nn.Tanh(), nn.Linear(64, outputs))

        self.critic, self.actor_mean = network(1), network(actions)
        self.actor_logstd = nn.Parameter(torch.zeros(1, actions))


def main(folder):
    """Write cleanrl.cleanrl_model and cleanrl.npz: statistics, raw observations, actions, values."""
    torch.manual_seed(0)
    env = gymnasium.wrappers.NormalizeObservation(gymnasium.make("Pendulum-v1"))
    env.action_space.seed(0)
    env.reset(seed=0)
    for _ in range(150):
        env.step(env.action_space.sample())
    agent, statistics = Agent(3, 1), env.obs_rms
    with torch.no_grad():
        agent.actor_mean[4].weight *= 8.0  # so that some actions are cut to the box
    torch.save(agent.state_dict(), folder / "cleanrl.cleanrl_model")
    raw = np.random.default_rng(0).normal(0.0, [1.0, 1.0, 8.0], (1000, 3))
    seen = np.clip((raw - statistics.mean) / np.sqrt(statistics.var + 1e-8), -10, 10)
    with torch.no_grad():
        tensor = torch.tensor(seen, dtype=torch.float32)
        actions = np.clip(agent.actor_mean(tensor).numpy(), env.action_space.low, env.action_space.high)
        values = agent.critic(tensor).numpy()[:, 0]
    arrays = {"mean": statistics.mean, "var": statistics.var, "raw": raw, "actions": actions, "values": values}
    np.savez_compressed(folder / "cleanrl.npz", **arrays)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
