"""Write models of Stable-Baselines3 and their actions, as truth for the tests of the readers.

    python tests/policy/readers/make_fixtures.py tests/policy/readers/fixtures [NAME ...]

Needs stable-baselines3 and sb3-contrib, which perdure itself does not. Each model is trained for a few steps, so that
its weights are not those of its start: on Pendulum-v1, or on the environment in `OTHER_ENVIRONMENTS`. With names, only
these are made anew.
"""

import sys
from pathlib import Path

import gymnasium
import numpy as np
import other_spaces

HORIZON = 50
"""Steps of the time feature; the recorded episodes go on far beyond it."""
ON_POLICY = {"n_steps": 32}
OFF_POLICY = {"learning_starts": 16, "batch_size": 16, "buffer_size": 1000}
RANDOM = ("dqn", "ars", "ars-mlp")
"""Models that hardly learn in a few steps: random numbers are added to their weights, so that actions differ."""
OTHER_ENVIRONMENTS = {
    **dict.fromkeys(("dqn", "qrdqn", "ppo-discrete"), "Acrobot-v1"),
    "a2c-multidiscrete": other_spaces.TWO_GEARS,
    "sac-dict": other_spaces.DICT,
    "ppo-onehot": "FrozenLake-v1",
}


def models():
    """Yield (name, algorithm, its arguments, arguments of the policy, whether behind VecNormalize, time feature)."""
    import torch
    from sb3_contrib import ARS, QRDQN, TQC, TRPO
    from stable_baselines3 import A2C, DDPG, DQN, PPO, SAC, TD3

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
    yield "dqn", DQN, OFF_POLICY, {}, False, False
    yield "qrdqn", QRDQN, OFF_POLICY, {"n_quantiles": 5}, False, False
    yield "ppo-discrete", PPO, ppo, {}, True, False
    yield "a2c-multidiscrete", A2C, ON_POLICY, {}, False, False
    yield "ppo-onehot", PPO, ppo, {}, False, False
    yield "sac-dict", SAC, OFF_POLICY, {}, True, False
    yield "ars", ARS, {"n_delta": 2}, None, True, False
    yield "ars-mlp", ARS, {"n_delta": 2}, {}, False, False


def make_env(name, timed, test_mode=False):
    """The environment of a model, with the time feature if asked for."""
    from gymnasium.envs.classic_control import PendulumEnv
    from gymnasium.wrappers import TimeLimit
    from sb3_contrib.common.wrappers import TimeFeatureWrapper

    if name in OTHER_ENVIRONMENTS:
        return gymnasium.make(OTHER_ENVIRONMENTS[name])
    if timed:  # without a limit of its own, so that the wrapper counts from HORIZON and beyond
        return TimeFeatureWrapper(PendulumEnv(), max_steps=HORIZON, test_mode=test_mode)
    return TimeLimit(PendulumEnv(), 200)


def train(name, algorithm, arguments, policy_arguments, normalized, timed, folder):
    """Train and save one model; return it with its VecNormalize, if any."""
    import torch
    from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

    env = DummyVecEnv([lambda: make_env(name, timed)])
    if normalized:
        env = VecNormalize(env, clip_obs=1.5)  # low, so that some observations meet it
    kind = "MlpPolicy"
    if isinstance(env.observation_space, gymnasium.spaces.Dict):
        kind = "MultiInputPolicy"
    policy_kwargs = {"net_arch": [16, 16], **(policy_arguments or {})}
    if policy_arguments is None:
        kind = "LinearPolicy"
        policy_kwargs = {}
    model = algorithm(kind, env, seed=0, device="cpu", policy_kwargs=policy_kwargs, **arguments)
    model.learn(128)
    if name in RANDOM:
        with torch.no_grad():
            for weights in filter(lambda each: each.ndim == 2, model.policy.parameters()):
                weights += 0.5 * torch.randn(weights.shape)
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
    env = make_env("", timed=True, test_mode=test_mode)
    observation, _ = env.reset(seed=1)
    observations, actions = [], []
    for _ in range(steps):
        action = act(model, normalizer, observation[None])[0]
        observations.append(observation[:-1])
        actions.append(action)
        observation = env.step(action)[0]
    return np.array(observations), np.array(actions)


def observations_of(name):
    """1,000 random observations as a batch of the environment's own form."""
    space = make_env(name, False).observation_space
    rng = np.random.default_rng(1)
    if isinstance(space, gymnasium.spaces.Discrete):
        return rng.integers(space.n, size=1000)
    if isinstance(space, gymnasium.spaces.Dict):
        return {key: rng.uniform(-8, 8, (1000, *part.shape)).astype(part.dtype) for key, part in space.items()}
    return rng.uniform(-1.5, 1.5, (1000, *space.shape)).astype(space.dtype)


def main(folder, *names):
    """Write everything, or the models of some names, into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(0)
    bound = np.array([1.5, 1.5, 12.0])
    recorded = {"observations": rng.uniform(-bound, bound, (1000, 3)).astype(np.float32)}
    if names:
        recorded = dict(np.load(folder / "actions.npz"))
    for name, *rest, timed in models():
        if names and name not in names:
            continue
        model, normalizer = train(name, *rest, timed, folder)
        if timed:
            for mode in (False, True):
                key = f"{name}-{'test_mode' if mode else 'countdown'}"
                recorded[f"{key}-observations"], recorded[key] = record_episode(model, normalizer, mode)
        elif name in OTHER_ENVIRONMENTS:
            seen = observations_of(name)
            space = make_env(name, False).observation_space
            rows = seen
            if isinstance(seen, dict):
                rows = [dict(zip(seen, row, strict=True)) for row in zip(*seen.values(), strict=True)]
            recorded[f"{name}-observations"] = np.array([gymnasium.spaces.flatten(space, row) for row in rows])
            recorded[name] = act(model, normalizer, seen)
        else:
            recorded[name] = act(model, normalizer, recorded["observations"])
    np.savez_compressed(folder / "actions.npz", **recorded)


if __name__ == "__main__":
    gymnasium.logger.min_level = 50
    main(Path(sys.argv[1]), *sys.argv[2:])
