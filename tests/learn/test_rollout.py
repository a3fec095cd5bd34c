"""A compiled rollout against the same world stepped by hand with the actions it took, and NumPy over what it saw."""

from __future__ import annotations

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from perdure.envs import make_world
from perdure.envs.traced import WorldSlot, traced_world
from perdure.horizon import Geometric, HorizonProtocol, Uniform
from perdure.learn import PPOConfig
from perdure.learn.networks import start_moments
from perdure.learn.ppo import PPO
from perdure.learn.rollout import draw, finish, make_collect, network_inputs, start_env_state, update_moments

SEEDS = [11, 12]
N_STEPS, SIZE = 64, 11
GAMMA = 0.9
PHI = Geometric(3, low=0.5)
CONFIG = PPOConfig(
    protocol=HorizonProtocol(PHI, Uniform(4, 30), "truncated", gamma=0.99, normalizer_gamma=GAMMA),
    n_envs=2,
    n_steps=N_STEPS,
    batch_size=32,
    hidden_sizes=(8,),
    log_std_init=0.5,
)


@pytest.fixture(scope="module")
def rollout():
    """Our rollout on EnvPool's Hopper-v3, in NumPy."""
    world = make_world("Hopper-v3", SEEDS)
    slot = WorldSlot()
    with jax.enable_x64(True):
        first = world.reset()
        slot.fill(world)
        state = PPO(CONFIG, world.spec).init(0)
        env_state = start_env_state(CONFIG, jnp.asarray(first), jnp.array([0.3, 0.9]))
        statistics = state.statistics._replace(
            observations=update_moments(CONFIG, state.statistics.observations, env_state)
        )
        draws = draw(jax.random.key(3), world.spec.action_size, config=CONFIG)
        collect = jax.jit(make_collect(traced_world(slot), world.spec, CONFIG))
        _, last, written = collect(slot.handle, (env_state, statistics), state.params, draws)
        result = jax.tree.map(np.asarray, finish(last, written, config=CONFIG))
        written = jax.tree.map(np.asarray, written)
    slot.clear()
    world.close()
    return SimpleNamespace(result=result, trace=written)


@pytest.fixture(scope="module")
def by_hand(rollout):
    """The same world, stepped in NumPy with the recorded actions and reset where the rollout says an episode ended."""
    world = make_world("Hopper-v3", SEEDS)
    done = rollout.result.episodes.done
    seen, after, rewards, terminated, elapsed = [world.reset()], [], [], [], []
    for step in range(N_STEPS):
        moved = world.step(rollout.result.experience.actions[step].astype(np.float64))
        now = moved.observations.copy()
        if done[step].any():
            now[done[step]] = world.reset(np.flatnonzero(done[step]))
        seen.append(now)
        after.append(moved.observations)
        rewards.append(moved.rewards)
        terminated.append(moved.terminated)
        elapsed.append(moved.elapsed)
    world.close()
    return SimpleNamespace(
        seen=np.array(seen),
        after=np.array(after),
        rewards=np.array(rewards),
        terminated=np.array(terminated),
        elapsed=np.array(elapsed),
    )


def moments_of(rows):
    """Mean and variance of rows, with the start values (mean 0, variance 1) weighing as much as 1e-4 of a row."""
    values = np.concatenate([np.zeros((1, rows.shape[1])), rows])
    weights = np.append(1e-4, np.ones(len(rows)))
    mean = np.average(values, axis=0, weights=weights)
    spread = np.square(values - mean)
    spread[0] += 1.0
    return mean, np.average(spread, axis=0, weights=weights)


def normalized(rows, mean, var):
    return np.clip((rows - mean) / np.sqrt(var + 1e-8), -10, 10)


def test_the_rollout_holds_falls_and_limits(rollout):
    ends = rollout.result.experience.ends
    assert ends.terminated.sum() >= 2
    assert (ends.horizon_end & ~ends.terminated).sum() >= 2


def test_observations_rewards_and_falls_are_those_of_the_world_stepped_by_hand(rollout, by_hand):
    np.testing.assert_array_equal(rollout.trace.observations, by_hand.after)
    np.testing.assert_array_equal(rollout.trace.step_result[:, 0], by_hand.rewards)
    np.testing.assert_array_equal(rollout.result.experience.ends.terminated, by_hand.terminated)
    np.testing.assert_array_equal(rollout.result.episodes.lengths, by_hand.elapsed)


def test_episodes_end_at_a_fall_or_at_a_horizon_drawn_for_each_of_them(rollout, by_hand):
    horizons = rollout.trace.counters[:, 1]
    ends = rollout.result.experience.ends
    np.testing.assert_array_equal(ends.horizon_end, by_hand.elapsed == horizons)
    assert np.all((horizons >= 4) & (horizons <= 30) & (horizons % 1 == 0))
    changed = horizons[1:] != horizons[:-1]
    assert changed.sum() >= 3
    assert ends.done[:-1][changed].all(), "a horizon may change only with an episode"
    assert not ends.truncated.any()


def test_returns_of_the_learning_curve_are_sums_of_raw_rewards(rollout, by_hand):
    running = np.zeros(2)
    for step in range(N_STEPS):
        running = running + by_hand.rewards[step]
        np.testing.assert_allclose(rollout.result.episodes.returns[step], running, rtol=1e-12)
        running[rollout.result.episodes.done[step]] = 0.0


def test_statistics_are_those_of_everything_seen_and_of_nothing_else(rollout, by_hand):
    mean, var = moments_of(by_hand.seen.reshape(-1, SIZE))
    found = rollout.result.statistics.observations
    np.testing.assert_allclose(found.mean, mean, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(found.var, var, rtol=1e-9)
    assert found.count == pytest.approx(2 * (N_STEPS + 1) + 1e-4)


def test_each_input_is_the_observation_normalized_by_what_was_seen_until_then_beside_phi_as_it_is(rollout, by_hand):
    inputs = rollout.result.experience.inputs
    horizons, elapsed = rollout.trace.counters[:, 1], by_hand.elapsed
    for step in range(N_STEPS):
        mean, var = moments_of(by_hand.seen[: step + 1].reshape(-1, SIZE))
        np.testing.assert_allclose(inputs[step, :, :SIZE], normalized(by_hand.seen[step], mean, var), rtol=0, atol=1e-5)
        np.testing.assert_allclose(inputs[step, :, SIZE:], PHI(elapsed[step] - 1, horizons[step]), rtol=1e-6)


def test_the_input_after_an_end_is_the_new_episodes_and_the_last_input_the_old_ones(rollout, by_hand):
    """No reset row reaches a value that is bootstrapped from."""
    experience = rollout.result.experience
    done = experience.ends.done
    for step in range(N_STEPS):
        mean, var = moments_of(by_hand.seen[: step + 2].reshape(-1, SIZE))
        last = normalized(by_hand.after[step], mean, var)
        np.testing.assert_allclose(experience.last_inputs[step, :, :SIZE], last, rtol=0, atol=1e-5)
    old, new = by_hand.after[done], by_hand.seen[1:][done]
    assert np.abs(old - new).max(axis=1).min() > 1e-3, "the two must differ for this test to mean something"
    np.testing.assert_array_equal(experience.last_inputs[~done], experience.inputs[1:][~done])


def test_phi_of_the_last_input_says_nothing_is_left_at_a_limit_and_the_next_time_elsewhere(rollout, by_hand):
    phi = rollout.result.experience.last_inputs[..., SIZE:]
    ends = rollout.result.experience.ends
    np.testing.assert_array_equal(phi[ends.horizon_end], 1.0)
    later = PHI(by_hand.elapsed, rollout.trace.counters[:, 1])
    np.testing.assert_allclose(phi[~ends.horizon_end], later[~ends.horizon_end], rtol=1e-6)
    fallen = ends.terminated & ~ends.horizon_end
    assert phi[fallen][:, 0].max() < 1.0, "a fall does not use up the time"


def test_rewards_are_scaled_by_the_spread_of_the_discounted_return_so_far(rollout, by_hand):
    running, all_returns = np.zeros(2), []
    for step in range(N_STEPS):
        running = GAMMA * running + by_hand.rewards[step]
        all_returns.append(running[:, None].copy())
        _, var = moments_of(np.concatenate(all_returns))
        expected = np.clip(by_hand.rewards[step] / np.sqrt(var[0] + 1e-8), -10, 10)
        np.testing.assert_allclose(rollout.result.experience.rewards[step], expected, rtol=1e-5)
        running[rollout.result.episodes.done[step]] = 0.0


class TestNormalizingPhi:
    """Two states, 10 and 1 steps before a horizon of 20."""

    @staticmethod
    def inputs(normalize_embedding):
        protocol = HorizonProtocol(PHI, Uniform(4, 30), "truncated", 0.99, GAMMA, normalize_embedding)
        config = PPOConfig(protocol=protocol, n_envs=2)
        with jax.enable_x64(True):
            observations = jnp.asarray(np.random.default_rng(0).normal(size=(2, SIZE)))
            env_state = start_env_state(config, observations, jnp.zeros(2))
            env_state = env_state._replace(
                counters=env_state.counters.at[0].set(jnp.array([10.0, 19.0])).at[1].set(20.0)
            )
            moments = update_moments(config, start_moments(SIZE + 3 * normalize_embedding), env_state)
            return np.asarray(network_inputs(config, moments, env_state.observations, *env_state.counters[:2]))

    def test_phi_is_left_as_it_is_by_default(self):
        np.testing.assert_allclose(self.inputs(False)[:, SIZE:], PHI(np.array([10, 19]), np.array([20, 20])), rtol=1e-6)

    def test_phi_goes_through_the_normalizer_in_a_replication(self):
        varying = self.inputs(True)[:, SIZE : SIZE + 2]
        np.testing.assert_allclose(varying, [[-1, -1], [1, 1]], atol=2e-3)


def test_a_program_whose_world_is_interrupted_or_taken_out_ends_on_zeros(monkeypatch, caplog):
    """JAX would log an error of its callback, and wrap it."""
    world, slot = make_world("gymnasium:Pendulum-v1", [0, 1]), WorldSlot()
    world.reset()
    slot.fill(world)

    def interrupted(actions):
        raise KeyboardInterrupt

    monkeypatch.setattr(world, "step", interrupted)
    with jax.enable_x64(True):
        step = jax.jit(traced_world(slot).step)
        for error, end in ((KeyboardInterrupt, lambda: None), (RuntimeError, slot.clear)):
            slot.fill(world)
            end()
            found = jax.block_until_ready(step(jnp.zeros(()), jnp.zeros((2, 1)))[1])
            assert not any(np.asarray(part).any() for part in found)
            assert isinstance(slot.error, error)
    world.close()
    assert not caplog.records
