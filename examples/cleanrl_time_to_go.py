"""The time-to-go in a single-file learner on `gymnasium.vector`, as CleanRL's are: what to wrap, and what to store.

    pip install "gymnasium[mujoco]"
    python examples/cleanrl_time_to_go.py --task Hopper-v5

The learner itself is left out: a linear policy and a linear value function stand for the networks. What matters is what
reaches the advantage: the flags kept apart, the rows that are resets left out, and the order of the wrappers.
"""

import argparse
from dataclasses import dataclass

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.wrappers import NormalizeObservation, RecordEpisodeStatistics

from perdure.horizon import Constant, Geometric, HorizonProtocol, Uniform
from perdure.wrappers import HorizonLimit, TimeToGoObservation


def make_env(task: str, protocol: HorizonProtocol) -> TimeToGoObservation:
    """Wrap in this order: time limit, statistics, normalizer, time-to-go, which is therefore not normalized."""
    env = HorizonLimit(gymnasium.make(task, max_episode_steps=-1), protocol.horizon, protocol.end)
    return TimeToGoObservation(NormalizeObservation(RecordEpisodeStatistics(env)), protocol.embedding)


def make_deployment(task: str, trained: TimeToGoObservation, steps_to_go: float) -> SyncVectorEnv:
    """One environment without a time limit, with the normalizer as it was trained and a constant time-to-go."""
    normalizer = NormalizeObservation(gymnasium.make(task, max_episode_steps=-1))
    normalizer.obs_rms, normalizer.update_running_mean = trained.env.obs_rms, False
    return SyncVectorEnv([lambda: TimeToGoObservation(normalizer, trained.embedding, clock=Constant(steps_to_go))])


@dataclass
class Rollout:
    """`num_steps` steps of every environment; first axis steps, second environments."""

    values: np.ndarray
    next_values: np.ndarray
    rewards: np.ndarray
    terminated: np.ndarray
    truncated: np.ndarray
    is_reset: np.ndarray


def collect(envs, policy, value, observations, is_reset, num_steps: int) -> tuple[Rollout, np.ndarray, np.ndarray]:
    """Acts for `num_steps` steps; returns the rollout and what the next one starts from."""
    rows = []
    low, high = envs.action_space.low, envs.action_space.high
    for _ in range(num_steps):
        actions = np.clip(observations @ policy, low, high).astype(envs.action_space.dtype)
        next_observations, rewards, terminated, truncated, _ = envs.step(actions)
        # In NEXT_STEP mode the observation after an end is the last one of its episode, with phi(T, T): its value is
        # the right one to bootstrap from. The step after that is a reset, not a transition.
        rows.append((value(observations), value(next_observations), rewards, terminated, truncated, is_reset))
        observations, is_reset = next_observations, terminated | truncated
    return Rollout(*(np.array(column) for column in zip(*rows, strict=True))), observations, is_reset


def advantages(rollout: Rollout, gamma: float, gae_lambda: float) -> np.ndarray:
    """Generalized advantage estimates; 0 in rows that are resets.

    A terminated step has no value after it. A truncated one has, but the next row belongs to another episode.
    """
    result, running = np.zeros_like(rollout.rewards), 0.0
    for step in reversed(range(len(rollout.rewards))):
        goes_on = ~(rollout.terminated[step] | rollout.truncated[step])
        bootstrap = gamma * np.where(rollout.terminated[step], 0.0, rollout.next_values[step])
        delta = rollout.rewards[step] + bootstrap - rollout.values[step]
        running = np.where(rollout.is_reset[step], 0.0, delta + gamma * gae_lambda * goes_on * running)
        result[step] = running
    return result


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--task", default="Hopper-v5")
    parser.add_argument("--num-envs", type=int, default=4)
    parser.add_argument("--num-steps", type=int, default=512)
    parser.add_argument("--iterations", type=int, default=5)
    parser.add_argument("--test-steps", type=int, default=5_000)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()

    protocol = HorizonProtocol(Geometric(10), Uniform(200, 1000), "terminated", gamma=1.0, normalizer_gamma=1.0)
    envs = SyncVectorEnv(
        [lambda: make_env(args.task, protocol)] * args.num_envs, autoreset_mode=AutoresetMode.NEXT_STEP
    )
    random = np.random.default_rng(args.seed)
    size = envs.single_observation_space.shape[0]
    policy = 0.1 * random.standard_normal((size, envs.single_action_space.shape[0]))
    weights = np.zeros(size)

    observations, _ = envs.reset(seed=args.seed)
    is_reset = np.zeros(args.num_envs, bool)
    for iteration in range(1, args.iterations + 1):
        rollout, observations, is_reset = collect(
            envs, policy, lambda rows: rows @ weights, observations, is_reset, args.num_steps
        )
        estimates = advantages(rollout, protocol.gamma, gae_lambda=0.95)
        # ... the update of policy and value function belongs here ...
        print(
            f"iteration {iteration}: {int((~rollout.is_reset).sum())} transitions, "
            f"{int(rollout.terminated.sum())} terminated, {int(rollout.truncated.sum())} truncated, "
            f"mean advantage {estimates[~rollout.is_reset].mean():.2f}"
        )

    deployed = make_deployment(args.task, envs.envs[0], steps_to_go=500.0)  # each normalizes for itself, as in CleanRL
    observations, _ = deployed.reset(seed=args.seed)
    total, steps, fell = 0.0, 0, False
    low, high = deployed.action_space.low, deployed.action_space.high
    while steps < args.test_steps and not fell:
        actions = np.clip(observations @ policy, low, high).astype(deployed.action_space.dtype)
        observations, rewards, terminated, _, _ = deployed.step(actions)
        total, steps, fell = total + float(rewards[0]), steps + 1, bool(terminated[0])
    print(f"deployed for {steps} of {args.test_steps} steps: return {total:.1f}")
    deployed.close()
    envs.close()


if __name__ == "__main__":
    main()
