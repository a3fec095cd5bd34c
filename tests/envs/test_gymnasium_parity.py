"""EnvPool's MuJoCo tasks against Gymnasium's own.

Gymnasium is put where EnvPool's reset observation says (x is 0), then both get the same actions. The engines are
different builds (MuJoCo 3.6 inside EnvPool, the installed `mujoco` under Gymnasium), so they agree to a tolerance over
20 steps. Actions are float32 numbers, the type that Gymnasium's environments take: a float64 action rounded on one side
only shows as a difference of 1e-7.
"""

import warnings
from dataclasses import dataclass

import numpy as np
import pytest

from perdure.envs import make_world

pytest.importorskip("mujoco")
STEPS = 20
CONTACT_FORCES = 84  # cfrc_ext: 14 bodies x 6


@dataclass(frozen=True)
class Robot:
    """How an observation lays out the state: positions without the first `unseen`, then velocities."""

    unseen: int
    tolerance: float
    """Relative and absolute. Measured worst of 4 seeds between MuJoCo 3.6 and 3.17, v3 to v5, in the comments below."""


ROBOTS = {
    "Hopper": Robot(1, 1e-9),  # 1.4e-15
    "HalfCheetah": Robot(1, 1e-7),  # 4.0e-11
    "Walker2d": Robot(1, 1e-9),  # 8.2e-14
    "Swimmer": Robot(2, 1e-9),  # 3.8e-15
    "Ant": Robot(2, 1e-5),  # 5.0e-7, where a contact is made; 1.1e-13 in the other seeds
    "Humanoid": Robot(2, 5e-3),  # 2.2e-5 in v3 and v4, 3.2e-4 in v5, whose contact forces reach 2e3
}
# EnvPool keeps the names of v3; Gymnasium no longer carries it, and its v4 has the same dynamics and rewards.
PAIRS = [(robot, ours, peer) for robot in ROBOTS for ours, peer in (("v3", "v4"), ("v4", "v4"), ("v5", "v5"))]


@pytest.fixture(autouse=True)
def _mujoco_logs_elsewhere(tmp_path, monkeypatch):  # MuJoCo writes its warnings to a file where it runs
    monkeypatch.chdir(tmp_path)


def peer_at(env_id: str, observation: np.ndarray, unseen: int):
    """Gymnasium's environment in the state that an observation describes, the unseen positions being 0."""
    import gymnasium

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        env = gymnasium.make(env_id, max_episode_steps=-1, disable_env_checker=True).unwrapped
    env.reset(seed=0)
    seen = env.model.nq - unseen
    env.set_state(np.append(np.zeros(unseen), observation[:seen]), observation[seen : seen + env.model.nv])
    return env


def both(robot: str, ours: str, peer: str, seed: int, state_seed: int):
    """Rows (observation, reward, terminated) of EnvPool from `seed` and of Gymnasium from the state of `state_seed`."""
    world = make_world(f"{robot}-{ours}", [seed, state_seed])
    env = peer_at(f"{robot}-{peer}", world.reset()[1], ROBOTS[robot].unseen)
    spec, generator = world.spec, np.random.default_rng(seed)
    for _ in range(STEPS):
        action = generator.uniform(spec.action_low, spec.action_high).astype(np.float32)
        step = world.step(action[None], np.array([0]))
        observation, reward, terminated, _, _ = env.step(action)
        yield (step.observations[0], step.rewards[0], step.terminated[0]), (observation, reward, terminated)
        if step.ended[0] or terminated:
            return


def compared(robot: str, ours: str, observation: np.ndarray, peer: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The entries both sides mean to be the same.

    As with MuJoCo 2 and later under Gym, contact forces are zeros in Ant-v3, Humanoid-v3 and Humanoid-v4 of EnvPool;
    Gymnasium's v4 has none in Ant and real ones in Humanoid.
    """
    if (robot, ours) in {("Ant", "v3"), ("Humanoid", "v3"), ("Humanoid", "v4")}:
        assert not observation[-CONTACT_FORCES:].any()
        observation = observation[:-CONTACT_FORCES]
        peer = peer[: len(observation)]
    return observation, peer


@pytest.mark.parametrize(("robot", "ours", "peer"), PAIRS)
@pytest.mark.parametrize("seed", [7, 8])
def test_envpool_moves_and_pays_as_gymnasium_does(robot: str, ours: str, peer: str, seed: int) -> None:
    tolerance = ROBOTS[robot].tolerance
    count = 0
    for (observation, reward, terminated), (expected, expected_reward, expected_terminated) in both(
        robot, ours, peer, seed, state_seed=seed
    ):
        count += 1
        seen, known = compared(robot, ours, observation, expected)
        np.testing.assert_allclose(seen, known, rtol=tolerance, atol=tolerance)
        single = max(tolerance, 1e-6)  # EnvPool's rewards are float32
        np.testing.assert_allclose(reward, expected_reward, rtol=single, atol=single)
        assert terminated == expected_terminated
    assert count >= 8  # otherwise it fell so early that little was compared


@pytest.mark.parametrize("robot", ROBOTS)
def test_from_another_state_they_disagree(robot: str) -> None:
    tolerance = ROBOTS[robot].tolerance
    for (observation, _, _), (other, _, _) in both(robot, "v5", "v5", seed=7, state_seed=8):
        assert not np.allclose(observation, other, rtol=tolerance, atol=tolerance)
