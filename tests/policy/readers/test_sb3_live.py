"""The readers against an installed Stable-Baselines3: everything is made anew, and episodes are run on both sides."""

from __future__ import annotations

import importlib
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from altered import Payload
from test_sb3_actions import OTHER_SPACES

from perdure.policy import Policy, measure_reference

pytestmark = pytest.mark.verify
pytest.importorskip("stable_baselines3")
pytest.importorskip("sb3_contrib")
TIMELESS = ("ppo", "ppo-sde", "a2c", "trpo", "sac", "sac-sde", "td3", "ddpg", "tqc", "ars", "ars-mlp")
TIMED = ("ppo-time", "sac-time")
PACKAGES = dict.fromkeys(("trpo", "tqc", "ars"), "sb3_contrib")


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("made")
    script = Path(__file__).with_name("make_fixtures.py")
    subprocess.run([sys.executable, str(script), str(folder)], check=True, timeout=600)
    return folder


def imported(folder, name, **options):
    statistics = folder / f"{name}.pkl"
    time_feature = "linear:50" if name in TIMED else None
    options |= {"normalizer": statistics if statistics.exists() else None, "time_feature": time_feature}
    env = f"gymnasium:{OTHER_SPACES.get(name, 'Pendulum-v1')}"
    return Policy.from_sb3(folder / f"{name}.zip", env, measure=False, **options)


def load(folder, name):
    """The model as Stable-Baselines3 loads it."""
    algorithm = name.split("-")[0]
    package = importlib.import_module(PACKAGES.get(algorithm, "stable_baselines3"))
    return getattr(package, algorithm.upper()).load(folder / f"{name}.zip", device="cpu")


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("trust", [False, True])
@pytest.mark.parametrize("name", [*TIMELESS, *TIMED, *OTHER_SPACES])
def test_actions_are_equal(name, trust, made):
    policy = imported(made, name, trust=trust)
    with np.load(made / "actions.npz") as recorded:
        key = f"{name}-countdown" if name in TIMED else name
        observations = recorded["observations" if name in TIMELESS else f"{key}-observations"]
        elapsed = np.arange(1000.0) if name in TIMED else np.zeros(1000)
        expected = recorded[key].reshape(1000, -1)
        np.testing.assert_allclose(policy.act(observations, elapsed), expected, rtol=0, atol=1e-6)


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", TIMELESS)
def test_returns_of_20_episodes_are_equal_within_their_interval(name, made):
    from gymnasium.envs.classic_control import PendulumEnv
    from gymnasium.wrappers import TimeLimit
    from stable_baselines3.common.evaluation import evaluate_policy
    from stable_baselines3.common.monitor import Monitor
    from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

    env = DummyVecEnv([lambda: Monitor(TimeLimit(PendulumEnv(), 200))])
    if (made / f"{name}.pkl").exists():
        env = VecNormalize.load(made / f"{name}.pkl", env)
        env.training = env.norm_reward = False
    env.seed(1)
    model = load(made, name)
    theirs = np.array(evaluate_policy(model, env, n_eval_episodes=20, return_episode_rewards=True)[0])
    ours = measure_reference(imported(made, name)).returns
    error = np.sqrt(theirs.var(ddof=1) / 20 + ours.var(ddof=1) / 20)
    assert abs(theirs.mean() - ours.mean()) < 3 * error


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", ["ppo", "sac"])
def test_the_same_episode_has_the_same_return(name, made):
    """One start state on both sides, 200 steps: the pendulum forgives rounding."""
    from gymnasium.envs.classic_control import PendulumEnv

    policy, env = imported(made, name), PendulumEnv()
    model = load(made, name)
    totals = []
    for act in (
        lambda seen: policy.act(seen[None], np.zeros(1))[0],
        lambda seen: model.predict(_normalized(policy, seen), deterministic=True)[0],
    ):
        observation, _ = env.reset(seed=3)
        total = 0.0
        for _ in range(200):
            observation, reward, *_ = env.step(np.asarray(act(observation), np.float32))
            total += float(reward)
        totals.append(total)
    assert totals[0] == pytest.approx(totals[1], rel=1e-3)


def _normalized(policy, seen):
    return policy.normalizer(seen[None]).astype(np.float32)[0]


def test_trust_runs_code_which_is_why_it_must_be_asked_for(made, tmp_path):
    """The control of the refusals: the payload works where files are trusted."""
    import pickle

    from perdure.errors import PerdureError

    path, trace = tmp_path / "statistics.pkl", tmp_path / "trace"
    path.write_bytes(pickle.dumps(Payload(trace)))
    for trust in (False, True):
        with pytest.raises(PerdureError):
            Policy.from_sb3(made / "ppo.zip", "Pendulum-v1", normalizer=path, trust=trust, measure=False)
        assert trace.exists() == trust
