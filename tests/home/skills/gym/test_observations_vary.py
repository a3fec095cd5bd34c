"""No element of an observation is idle: over random motions and whole skills each one takes several values."""

import numpy as np
import pytest
from lanes import make

from perdure.home.agents.scripted import Oracle
from perdure.home.sim.sensors import SCAN_RANGE
from perdure.home.skills import learned_skills

STEPS = {"place": 200, "navigate": 80}
CONSTANT = {"open_fridge": {"handle_in_base_z"}, "close_fridge": {"handle_in_base_z"}}
"""The fridge's handle is 1.14 m above the floor in every apartment."""


@pytest.mark.parametrize("skill", learned_skills())
def test_no_element_of_an_observation_is_constant(skill):
    env = make(skill, "set_table", lanes=6, episodes=64, delta=3 if skill == "place" else 1, clutter=skill == "pick")
    oracle, rng = Oracle(), np.random.default_rng(0)
    seen = [env.reset(seed=3)[0]]
    clever = np.arange(3)
    for lane in clever:
        oracle.begin(env.world, int(lane), env.skill)
    for _ in range(STEPS.get(skill, 90)):
        actions = rng.uniform(-1.0, 1.0, env.action_space.shape)
        planned = oracle.act(env.world, clever, env.skill, env.state[clever], env.progress[clever])
        actions[clever] = planned[:, : actions.shape[1]]
        observations, _, terminated, truncated, _ = env.step(actions)
        seen.append(observations)
        if (terminated | truncated).any():
            env.reset(options={"reset_mask": terminated | truncated})
            for lane in np.intersect1d(clever, np.flatnonzero(terminated | truncated)):
                oracle.begin(env.world, int(lane), env.skill)
    seen += [env.reset(seed=100 + 6 * k)[0] for k in range(30)]
    spread = np.ptp(np.concatenate(seen), axis=0)
    idle = {each.name for each, width in zip(env.skill.elements, spread, strict=True) if width < 1e-6}
    assert idle == CONSTANT.get(skill, set())


@pytest.mark.parametrize("skill", learned_skills())
def test_what_a_skill_does_not_look_at_does_not_change_what_it_sees(skill):
    """The executor scans once for all skills, as far as the one that looks farthest."""
    env = make(skill, "set_table", lanes=6, episodes=64)
    seen, _ = env.reset(seed=0)
    known = env.world.sense(None, SCAN_RANGE, env.skill.needs_neighbors)
    np.testing.assert_array_equal(env.skill.observe(known, env.progress), seen)
    assert known.scan.max() == SCAN_RANGE
    assert (known.scan > 2.0).any()
