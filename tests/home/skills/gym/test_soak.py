"""Random actions for many episodes: no observation that is not a number, no crash, memory that does not grow."""

from pathlib import Path
from resource import getpagesize

import gymnasium
import numpy as np
import pytest
from lanes import make

from perdure.home.skills import learned_skills
from perdure.home.skills.gym import env_id

LANES = 16
STATUS = Path("/proc/self/statm")


def resident():
    """Resident memory in [MiB] now; the largest ever would hide a leak behind what other tests took before."""
    return int(STATUS.read_text().split()[1]) * getpagesize() / 2**20


def soak(skill, episodes, memory=lambda: 0.0):
    """Runs at least so many episodes with random actions; what `memory` says halfway and at the end."""
    env = make(skill, gymnasium.spec(env_id(skill)).kwargs["task"], lanes=LANES, episodes=20)
    rng = np.random.default_rng(0)
    observations, _ = env.reset(seed=0)
    ended, found = 0, []
    while ended < episodes:
        # Slow drifts as well as noise: the robot goes somewhere.
        if ended % 5 == 0:
            drift = rng.uniform(-1.0, 1.0, env.action_space.shape)
        actions = np.clip(drift + rng.normal(0.0, 0.5, env.action_space.shape), -1.0, 1.0)
        if actions.shape[1] == 10 and rng.random() < 0.9:
            actions[:, 9] = np.abs(actions[:, 9])  # or nothing would ever be carried
        observations, rewards, terminated, truncated, info = env.step(actions)
        assert np.isfinite(observations).all()
        assert np.isfinite(rewards).all()
        over = terminated | truncated | (info["elapsed"] >= env.skill.limit)
        if over.any():
            ended += int(over.sum())
            observations, _ = env.reset(options={"reset_mask": over})
            assert np.isfinite(observations).all()
        if len(found) == 0 and ended >= episodes // 2:
            found.append(memory())
    found.append(memory())
    env.close()
    return found


@pytest.mark.verify
@pytest.mark.parametrize("skill", ["place", "open_drawer"])
def test_a_sample_of_random_episodes(skill):
    soak(skill, 40)


@pytest.mark.verify
@pytest.mark.skipif(not STATUS.exists(), reason="memory is read where Linux shows it")
@pytest.mark.parametrize("skill", learned_skills())
def test_ten_thousand_random_episodes_over_all_skills(skill, monkeypatch):
    # The store of left worlds fills up for thousands of episodes; a small one is full long before halfway.
    monkeypatch.setattr("perdure.home.sim.vector_simulator.MAX_IDLE", 40)
    halfway, at_the_end = soak(skill, 10_000 // len(learned_skills()) + 1, memory=resident)
    assert at_the_end - halfway < 40.0
