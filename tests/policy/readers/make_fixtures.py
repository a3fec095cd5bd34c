"""Write models of Stable-Baselines3 and their actions, as truth for the tests of the readers.

    python tests/policy/readers/make_fixtures.py tests/policy/readers/fixtures

Needs stable-baselines3 and sb3-contrib, which perdure itself does not. Each model is trained for a few steps on
Pendulum-v1, so that its weights are not those of its start.
"""

import sys
from pathlib import Path

import gymnasium
import numpy as np

HORIZON = 50
"""Steps of the time feature; the recorded episodes go on far beyond it."""
ON_POLICY = {"n_steps": 32}
OFF_POLICY = {"learning_starts": 16, "batch_size": 16, "buffer_size": 1000}


def models():
    """Yield (name, algorithm, its arguments, arguments of the policy, whether behind VecNormalize, time feature)."""
    import torch
    from sb3_contrib import TQC, TRPO
    from stable_baselines3 import A2C, DDPG, PPO, SAC, TD3

    nn, ppo = torch.nn, {**ON_POLICY, "batch_size": 32, "n_epochs": 2}
    yield "ppo", PPO, ppo, {}, True, False
    yield "ppo-sde", PPO, {**ppo, "use_sde": True}, {"squash_output": True}, False, False
    yield "ppo-time", PPO, ppo, {"activation_fn": nn.ReLU}, True, True
    yield "a2c", A2C, ON_POLICY, {"activation_fn": nn.SiLU}, True, False
    yield "trpo", TRPO, {**ON_POLICY, "batch_size": 32}, {"activation_fn": nn.ELU}, False, False
    yield "sac", SAC, OFF_POLICY, {"activation_fn": nn.GELU}, False, False
    yield "sac-sde", SAC, {**OFF_POLICY, "use_sde": True}, {}, True, False
    yield "sac-time", SAC, OFF_POLICY, {}, False, True
    yield "td3", TD3, OFF_POLICY, {"activation_fn": nn.LeakyReLU}, False, False
    yield "ddpg", DDPG, OFF_POLICY, {}, False, False
    yield "tqc", TQC, OFF_POLICY, {"n_quantiles": 5}, True, False


def make_env(timed, test_mode=False):
    """Pendulum-v1, with the time feature if asked for."""
    from gymnasium.envs.classic_control import PendulumEnv
    from gymnasium.wrappers import TimeLimit
    from sb3_contrib.common.wrappers import TimeFeatureWrapper

    if timed:  # without a limit of its own, so that the wrapper counts from HORIZON and beyond
        return TimeFeatureWrapper(PendulumEnv(), max_steps=HORIZON, test_mode=test_mode)
    return TimeLimit(PendulumEnv(), 200)


def train(name, algorithm, arguments, policy_arguments, normalized, timed, folder):
    """Train and save one model; return it with its VecNormalize, if any."""
    from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

    env = DummyVecEnv([lambda: make_env(timed)])
    if normalized:
        env = VecNormalize(env, clip_obs=1.5)  # low, so that some observations meet it
    model = algorithm(
        "MlpPolicy", env, seed=0, device="cpu", policy_kwargs={"net_arch": [16, 16], **policy_arguments}, **arguments
    )
    model.learn(128)
    model.save(folder / f"{name}.zip")
    if normalized:
        env.training = False
        env.save(folder / f"{name}.pkl")
    return model, env if normalized else None


def act(model, normalizer, observations):
    """What Stable-Baselines3 does, all rows at once."""
    seen = observations if normalizer is None else normalizer.normalize_obs(observations)
    return model.predict(seen, deterministic=True)[0]


def record_episode(model, normalizer, test_mode, steps=1000):
    """One episode that goes on beyond the time feature's horizon: (observations without it, actions)."""
    env = make_env(timed=True, test_mode=test_mode)
    observation, _ = env.reset(seed=1)
    observations, actions = [], []
    for _ in range(steps):
        action = act(model, normalizer, observation[None])[0]
        observations.append(observation[:-1])
        actions.append(action)
        observation = env.step(action)[0]
    return np.array(observations), np.array(actions)


def main(folder):
    """Write everything into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(0)
    bound = np.array([1.5, 1.5, 12.0])
    recorded = {"observations": rng.uniform(-bound, bound, (1000, 3)).astype(np.float32)}
    for name, *rest, timed in models():
        model, normalizer = train(name, *rest, timed, folder)
        if timed:
            for mode in (False, True):
                key = f"{name}-{'test_mode' if mode else 'countdown'}"
                recorded[f"{key}-observations"], recorded[key] = record_episode(model, normalizer, mode)
        else:
            recorded[name] = act(model, normalizer, recorded["observations"])
    np.savez_compressed(folder / "actions.npz", **recorded)


if __name__ == "__main__":
    gymnasium.logger.min_level = 50
    main(Path(sys.argv[1]))
