"""Stable-Baselines3 with the time-to-go in the observation: train in finite episodes, deploy without end.

    pip install "stable-baselines3>=2.7" "gymnasium[mujoco]"
    python examples/sb3_time_to_go.py --task Hopper-v5 --train-steps 1000000

Three things to mind with Stable-Baselines3:

* Its PPO bootstraps at every truncation. A policy with a time-to-go input observes that nothing follows its horizon,
  so the horizon ends episodes with ``end="terminated"``.
* ``VecNormalize`` would normalize phi with the statistics of training, and phi would mean something else in deployment.
  With ``dict=True`` phi has a key of its own, and ``norm_obs_keys`` leaves it out.
* ``Monitor`` goes above the wrappers; below them it would not see the horizons. (``make_vec_env`` puts it below.)
"""

import argparse

import gymnasium
import numpy as np
from stable_baselines3 import PPO
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

from perdure.horizon import Clock, Constant, Geometric, HorizonProtocol, Uniform, geometric_size
from perdure.wrappers import HorizonLimit, TimeToGoObservation


def make_protocol(task: str) -> HorizonProtocol:
    """How the thesis treats time: undiscounted, random horizons, the geometric embedding."""
    env = gymnasium.make(task)
    size = geometric_size(env.observation_space.shape[0], task)
    env.close()
    return HorizonProtocol(Geometric(size), Uniform(200, 1000), "terminated", gamma=1.0, normalizer_gamma=1.0)


def make_training_env(task: str, protocol: HorizonProtocol) -> VecNormalize:
    """One environment with random horizons; observations and rewards normalized, phi not."""

    def make() -> gymnasium.Env:
        env = gymnasium.make(task, max_episode_steps=-1)  # no limit but ours
        env = HorizonLimit(env, protocol.horizon, protocol.end)
        return Monitor(TimeToGoObservation(env, protocol.embedding, dict=True))

    return VecNormalize(DummyVecEnv([make]), gamma=protocol.normalizer_gamma, norm_obs_keys=["observation"])


def make_deployment_env(task: str, protocol: HorizonProtocol, clock: Clock) -> gymnasium.Env:
    """The same environment without a horizon; a clock sets the time-to-go input."""
    env = gymnasium.make(task, max_episode_steps=-1)
    return TimeToGoObservation(env, protocol.embedding, clock=clock, dict=True)


def deploy(model: PPO, training_env: VecNormalize, env: gymnasium.Env, steps: int, seed: int) -> tuple[float, int]:
    """Return of one episode, and the steps it lasted: at most `steps`."""
    observation, _ = env.reset(seed=seed)
    total, survived, terminated = 0.0, 0, False
    while survived < steps and not terminated:
        action, _ = model.predict(training_env.normalize_obs(observation), deterministic=True)
        observation, reward, terminated, _, _ = env.step(action)
        total, survived = total + float(reward), survived + 1
    return total, survived


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--task", default="Hopper-v5")
    parser.add_argument("--train-steps", type=int, default=1_000_000)
    parser.add_argument("--deploy-steps", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()

    protocol = make_protocol(args.task)
    env = make_training_env(args.task, protocol)
    model = PPO("MultiInputPolicy", env, gamma=protocol.gamma, seed=args.seed, verbose=1)
    model.learn(args.train_steps)

    raw = env.get_original_obs()
    assert np.array_equal(env.normalize_obs(raw)["time_to_go"], raw["time_to_go"]), "phi must not be normalized"
    for steps_to_go in (100, 500, 1000):
        clock = Constant(steps_to_go)
        world = make_deployment_env(args.task, protocol, clock)
        total, survived = deploy(model, env, world, args.deploy_steps, args.seed)
        print(f"{clock.label}: return {total:.0f} over {survived} of {args.deploy_steps} steps")


if __name__ == "__main__":
    main()
