"""However a vector of environments resets itself, the same policy and seeds give the same returns."""

from __future__ import annotations

from functools import partial

import envpool
import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AsyncVectorEnv, AutoresetMode, SyncVectorEnv
from probes import Falling

import perdure
from perdure.evaluate.episodes import FIRST_EVAL_SEED

pytestmark = pytest.mark.usefixtures("short_idle")
hopper = partial(gymnasium.make, "Hopper-v5")
EPISODES = 6
FACTS = ["step", "return", "alive", "end_step", "end_reason", "outcome", "training_rate", "policy_state"]


def swing(observations):
    """Deterministic, and falls after some time that depends on the start."""
    size = 1 if observations.shape[1] == 2 else 3
    return np.sin(3.0 * observations.sum(axis=1, keepdims=True) + np.arange(size))


def evaluated(env):
    options = {"steps": 200, "eval_seeds": EPISODES, "training_horizon": 50, "name": "swing", "disturb": "none"}
    return perdure.extrapolate(swing, env, **options).frame.select(FACTS)


@pytest.fixture(scope="module", params=[Falling, hopper], ids=["probe", "Hopper-v5"])
def env(request):
    return request.param


@pytest.fixture(scope="module")
def single(env):
    """By a factory: each environment on its own, reset by perdure alone."""
    return evaluated(env)


def test_episodes_end_at_different_steps_so_that_there_is_something_to_reset(single):
    ends = single.filter(single["step"] == 200)["end_step"].to_list()
    assert len(set(ends)) > 3
    assert max(ends) < 200


@pytest.mark.parametrize("mode", AutoresetMode)
@pytest.mark.parametrize("episodes", [EPISODES, 4])
def test_every_mode_of_a_vector_gives_the_returns_of_single_environments(env, single, mode, episodes):
    """With four episodes the six episodes take two passes, and the spare episodes of the second are nobody's."""
    with_mode = SyncVectorEnv([env] * episodes, autoreset_mode=mode)
    assert evaluated(with_mode).select(FACTS[:6]).equals(single.select(FACTS[:6]))


def test_so_do_environments_in_processes_of_their_own():
    vector = AsyncVectorEnv([Falling] * EPISODES, autoreset_mode=AutoresetMode.SAME_STEP)
    assert evaluated(vector).select(FACTS[:6]).equals(evaluated(Falling).select(FACTS[:6]))
    vector.close()


@pytest.mark.parametrize("mode", AutoresetMode)
def test_a_loop_that_overlooks_the_reset_has_other_returns(env, single, mode):
    """The control: it goes on adding up rewards after the end, as the vector does not stop by itself."""
    vector = SyncVectorEnv([env] * EPISODES, autoreset_mode=mode)
    seen, _ = vector.reset(seed=[FIRST_EVAL_SEED + k for k in range(EPISODES)])
    total = np.zeros(EPISODES)
    for _ in range(200):
        if mode is AutoresetMode.DISABLED and (ended := getattr(vector, "_control", np.zeros(EPISODES, bool))).any():
            seen, _ = vector.reset(options={"reset_mask": ended})
        seen, rewards, terminated, truncated, _ = vector.step(swing(seen))
        vector._control = terminated | truncated
        total += rewards
    final = single.filter(single["step"] == 200)["return"].to_numpy()
    assert (total[: len(final)] != final).all()


def test_the_reset_of_envpool_at_the_next_step_gives_the_returns_of_its_task():
    """EnvPool by hand, all rows at every step, as its users drive it; rewards count up to an episode's first end."""
    seeds = [FIRST_EVAL_SEED + k for k in range(EPISODES)]
    pool = envpool.make_gymnasium("Hopper-v4", num_envs=EPISODES, seed=seeds, max_episode_steps=10**6)
    seen, _ = pool.reset()
    total, over, both = np.zeros(EPISODES), np.zeros(EPISODES, bool), np.zeros(EPISODES)
    lasts = np.zeros(EPISODES)
    for _ in range(200):
        seen, rewards, terminated, truncated, _ = pool.step(swing(seen))
        both += rewards
        total += np.where(over, 0.0, rewards)
        lasts += ~over
        over |= terminated | truncated
    options = {"steps": 200, "eval_seeds": EPISODES, "training_horizon": 50, "disturb": "none"}
    found = perdure.extrapolate(swing, "envpool:Hopper-v4", **options).final
    assert found["end_step"].to_list() == lasts.tolist()
    np.testing.assert_allclose(found["return"], total, rtol=1e-12)
    assert (found["return"].to_numpy() != both).any(), "the control: without an eye on the reset they differ"
