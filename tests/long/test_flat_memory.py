"""A long evaluation does not grow."""

import os
from pathlib import Path

import numpy as np
import pytest

from perdure.evaluate.episodes import EpisodeSpec, evaluate_episodes
from perdure.policy import load_policy

LANE_STEPS = int(os.environ.get("PERDURE_SOAK_STEPS", "10000000"))
EPISODES = 50
MOST_GROWTH = 20 * 2**20
"""Bytes; a single observation kept for every episode-step would be 1.4 GB."""


def resident():
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


@pytest.mark.verify
def test_memory_is_flat_over_many_episode_steps():
    policy, seen = load_policy("HalfCheetah-v3/ppo"), []
    episodes = [EpisodeSpec(0, None, seed) for seed in range(EPISODES)]
    steps = LANE_STEPS // EPISODES
    records = evaluate_episodes([policy], episodes, steps, lambda step, running: seen.append((step, resident())))
    assert (records.end_step == steps).mean() > 0.5, "episodes that end do not soak"
    settled = [size for step, size in seen if step > 0.1 * steps]
    assert len(settled) > 10
    growth = np.mean(settled[-3:]) - np.mean(settled[:3])
    print(f"{steps * EPISODES:,} episode-steps: {settled[0] / 2**20:.0f} MiB, then {growth / 2**20:+.1f} MiB")
    assert growth < MOST_GROWTH
