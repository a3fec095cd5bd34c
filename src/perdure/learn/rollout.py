"""Collect experience: n_steps of every environment in one compiled program.

`make_collect` builds the loop. It does only what the next action depends on, in few large arrays, because each array
costs the compiled loop about a microsecond a step. `finish` computes everything else for the whole rollout afterwards.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

import jax
import jax.numpy as jnp

from perdure.envs.traced import Handle, TracedWorld
from perdure.learn.advantages import Ends
from perdure.learn.networks import EPSILON, Params, RunningMoments, forward, merge, normalize, scale_rewards

if TYPE_CHECKING:
    from perdure.envs import TaskSpec
    from perdure.learn.config import PPOConfig


class EnvState(NamedTuple):
    """State of one seed's environments."""

    observations: jax.Array
    """As the world gave them, (n_envs, observation_size), float64."""
    counters: jax.Array
    """Rows: steps since reset; steps the running episode may last, perhaps infinite; running discounted reward, whose
    spread scales the rewards; undiscounted return of the running episode. Shape (4, n_envs), float64."""


class Statistics(NamedTuple):
    """Normalizer statistics of one seed."""

    observations: RunningMoments
    returns: RunningMoments


Carry = tuple[EnvState, Statistics]
"""What the loop carries from step to step beside the engine's handle, see `jax.lax.scan`."""


class Draws(NamedTuple):
    """All random numbers of a rollout, drawn in advance: leading axes (n_steps, n_envs)."""

    noise: jax.Array
    horizon: jax.Array


class Trace(NamedTuple):
    """Values that the loop records at each step."""

    inputs: jax.Array
    actions: jax.Array
    observations: jax.Array
    """After the step, before any reset."""
    counters: jax.Array
    """After the step, before any reset; shape (4, n_envs)."""
    step_result: jax.Array
    """Rows reward, terminated, truncated; shape (3, n_envs)."""
    moments: jax.Array
    """Mean and variance of the observations, after the step; shape (2, d)."""
    return_var: jax.Array
    """Variance of the running discounted reward, after the step."""


class Experience(NamedTuple):
    """Transitions of one seed for the update: float32. Leading axes (n_steps, n_envs)."""

    inputs: jax.Array
    """What the networks saw; here the leading axis is n_steps + 1: the last row follows the rollout."""
    last_inputs: jax.Array
    """What the networks would have seen of the state a step led to, before any reset."""
    actions: jax.Array
    """As sampled, before clipping to the action box."""
    rewards: jax.Array
    """Scaled."""
    ends: Ends
    return_std: jax.Array
    """What the rewards were divided by, (n_steps, 1)."""


class Episodes(NamedTuple):
    """The running episodes at each step, for the learning curve. Axes (n_steps, n_envs)."""

    returns: jax.Array
    """Undiscounted and unscaled return so far, float64."""
    lengths: jax.Array
    """Steps so far."""
    done: jax.Array
    """The episode ended with this step."""


class Rollout(NamedTuple):
    """Result of one seed's rollout."""

    env_state: EnvState
    statistics: Statistics
    experience: Experience
    episodes: Episodes


def draw(key: jax.Array, action_size: int, config: PPOConfig) -> Draws:
    """Return all random numbers of one seed's rollout; to be compiled under x64."""
    noise_key, horizon_key = jax.random.split(key)
    shape = (config.n_steps, config.n_envs)
    noise = jax.random.normal(noise_key, (*shape, action_size), jnp.float32)
    return Draws(noise, jax.random.uniform(horizon_key, shape, jnp.float64))


def make_collect(
    world: TracedWorld, spec: TaskSpec, config: PPOConfig
) -> Callable[[Handle, Carry, Params, Draws], tuple[Handle, Carry, Trace]]:
    """Build the loop over ``config.n_steps`` steps of a seed's environments; to be compiled under x64.

    It returns the engine's handle, the state after the last step, and the trace from which `finish` makes experience.
    """
    low = jnp.asarray(spec.action_low)
    high = jnp.asarray(spec.action_high)
    gamma = config.protocol.normalizer_gamma
    horizon = config.protocol.horizon

    def collect(handle: Handle, start: Carry, params: Params, draws: Draws) -> tuple[Handle, Carry, Trace]:
        def step(carry: tuple[Handle, Carry], draw: Draws) -> tuple[tuple[Handle, Carry], Trace]:
            # Act: the mean of the Gaussian and noise, cut to the action box, since EnvPool clips nothing.
            handle, (env_state, statistics) = carry
            inputs = _current_inputs(config, env_state, statistics)
            mean = forward(params, "policy", inputs, config.activation)
            actions = mean + jnp.exp(params["log_std"]) * draw.noise
            handle, stepped = world.step(handle, jnp.clip(actions.astype(jnp.float64), low, high))

            # Count: has the episode ended, by the task, by the engine or by its training horizon?
            elapsed, horizons, discounted, returns = env_state.counters
            rewards = stepped.rewards
            counters = jnp.stack([elapsed + 1, horizons, discounted * gamma + rewards, returns + rewards])
            done = Ends(stepped.terminated, stepped.truncated, counters[0] >= counters[1]).done
            # Reset what ended. Resets leave the program, so they are paid for only when an episode ends.
            observations = jax.lax.cond(
                done.any(),
                lambda: jnp.where(done[:, None], world.reset(done), stepped.observations),
                lambda: stepped.observations,
            )
            restarted = _start_counters(horizon.from_uniform(draw.horizon))
            now = EnvState(observations, jnp.where(done, restarted, counters))
            # Update the normalizers with what follows the step.
            seen = Statistics(
                update_moments(config, statistics.observations, now), merge(statistics.returns, counters[2][:, None])
            )
            traced = Trace(
                inputs=inputs,
                actions=actions,
                observations=stepped.observations,
                counters=counters,
                step_result=jnp.stack([stepped.rewards, stepped.terminated, stepped.truncated]),
                moments=jnp.stack([seen.observations.mean, seen.observations.var]),
                return_var=seen.returns.var,
            )
            return (handle, (now, seen)), traced

        (handle, last), traced = jax.lax.scan(step, (handle, start), draws)
        return handle, last, traced

    return collect


def finish(last: Carry, trace: Trace, *, config: PPOConfig) -> Rollout:
    """Return the results of one seed's trace, for all steps at once; to be compiled under x64."""
    env_state, statistics = last
    elapsed, horizons, _, returns = (trace.counters[:, row] for row in range(4))
    rewards, terminated, truncated = (trace.step_result[:, row] for row in range(3))
    ends = Ends(terminated > 0, truncated > 0, elapsed >= horizons)
    moments = RunningMoments(trace.moments[:, :1], trace.moments[:, 1:], statistics.observations.count)
    experience = Experience(
        inputs=jnp.concatenate([trace.inputs, _current_inputs(config, env_state, statistics)[None]]),
        last_inputs=network_inputs(config, moments, trace.observations, elapsed, horizons),
        actions=trace.actions,
        rewards=scale_rewards(trace.return_var, rewards),
        ends=ends,
        return_std=jnp.sqrt(trace.return_var + EPSILON).astype(jnp.float32),
    )
    return Rollout(env_state, statistics, experience, Episodes(returns, elapsed, ends.done))


def start_env_state(config: PPOConfig, observations: jax.Array, uniform: jax.Array) -> EnvState:
    """Return the state of environments after a reset; ``uniform`` in [0, 1), shape (n_envs,), draws their horizons."""
    return EnvState(observations, _start_counters(config.protocol.horizon.from_uniform(uniform)))


def _start_counters(horizons: jax.Array) -> jax.Array:
    zeros = jnp.zeros_like(horizons)
    return jnp.stack([zeros, horizons, zeros, zeros])


def update_moments(config: PPOConfig, moments: RunningMoments, env_state: EnvState) -> RunningMoments:
    """Return the moments, updated with the current observation of each environment."""
    observations = env_state.observations
    if config.protocol.normalize_embedding:
        phi = config.protocol.embed(*env_state.counters[:2])
        observations = jnp.concatenate([observations, phi], axis=-1)
    return merge(moments, observations)


def network_inputs(
    config: PPOConfig, moments: RunningMoments, observations: jax.Array, elapsed: jax.Array, horizons: jax.Array
) -> jax.Array:
    """Return the normalized observation and phi, float32. phi passes the normalizer only in a replication."""
    phi = config.protocol.embed(elapsed, horizons)
    if config.protocol.normalize_embedding:
        return normalize(moments, jnp.concatenate([observations, phi], axis=-1), config.clip_obs)
    return jnp.concatenate([normalize(moments, observations, config.clip_obs), phi.astype(jnp.float32)], axis=-1)


def _current_inputs(config: PPOConfig, now: EnvState, statistics: Statistics) -> jax.Array:
    return network_inputs(config, statistics.observations, now.observations, *now.counters[:2])
