"""Collect experience: n_steps of every environment in one compiled program.

The loop does only what the next action depends on, in few large arrays, because each array costs the compiled loop
about a microsecond a step. Everything else is computed for the whole rollout afterwards.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

import jax
import jax.numpy as jnp

from perdure.envs.traced import Handle, TracedStep, TracedWorld
from perdure.learn.advantages import Ends
from perdure.learn.networks import EPSILON, Params, RunningMoments, forward, merge, normalize, scale_rewards

if TYPE_CHECKING:
    from perdure.envs.world import TaskSpec
    from perdure.learn.config import PPOConfig


class EnvState(NamedTuple):
    """State of one seed's environments."""

    observations: jax.Array
    """As the world gave them, (n_envs, observation_size), float64."""
    counters: jax.Array
    """Rows elapsed, horizon, discounted, returns; shape (4, n_envs), float64."""

    @property
    def elapsed(self) -> jax.Array:
        """Steps since reset, (n_envs,)."""
        return self.counters[0]

    @property
    def horizons(self) -> jax.Array:
        """Steps the running episode may last, (n_envs,); may be infinite."""
        return self.counters[1]

    @property
    def discounted(self) -> jax.Array:
        """Running discounted reward, whose spread scales the rewards, (n_envs,)."""
        return self.counters[2]

    @property
    def returns(self) -> jax.Array:
        """Undiscounted return of the running episode, (n_envs,)."""
        return self.counters[3]


def start_env_state(config: PPOConfig, observations: jax.Array, uniform: jax.Array) -> EnvState:
    """Return the state of environments after a reset; ``uniform`` in [0, 1), shape (n_envs,), draws their horizons."""
    zeros = jnp.zeros_like(uniform)
    return EnvState(observations, jnp.stack([zeros, config.protocol.horizon.from_uniform(uniform), zeros, zeros]))


class Statistics(NamedTuple):
    """Normalizer statistics of one seed."""

    observations: RunningMoments
    returns: RunningMoments


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


class SeedRollout(NamedTuple):
    """Result of one seed's rollout."""

    env_state: EnvState
    statistics: Statistics
    experience: Experience
    episodes: Episodes


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


def network_inputs(
    config: PPOConfig, moments: RunningMoments, observations: jax.Array, elapsed: jax.Array, horizons: jax.Array
) -> jax.Array:
    """Return the normalized observation and phi, float32. phi passes the normalizer only in a replication."""
    phi = config.protocol.embed(elapsed, horizons)
    if config.protocol.normalize_embedding:
        return normalize(moments, jnp.concatenate([observations, phi], axis=-1))
    return jnp.concatenate([normalize(moments, observations), phi.astype(jnp.float32)], axis=-1)


def update_moments(config: PPOConfig, moments: RunningMoments, env_state: EnvState) -> RunningMoments:
    """Return the moments, updated with the current observation of each environment."""
    observations = env_state.observations
    if config.protocol.normalize_embedding:
        phi = config.protocol.embed(env_state.elapsed, env_state.horizons)
        observations = jnp.concatenate([observations, phi], axis=-1)
    return merge(moments, observations)


Seed = tuple[EnvState, Statistics]
"""State of one seed during collection."""


def make_collect(
    world: TracedWorld, spec: TaskSpec, config: PPOConfig
) -> Callable[[Handle, Seed, Params, Draws], tuple[Handle, Seed, Trace]]:
    """Build the loop over ``config.n_steps`` steps of a seed's environments; to be compiled under x64.

    It gives the handle, where the seed stands, and what it wrote down. ``finish`` makes experience of that.
    """
    low, high = jnp.asarray(spec.action_low), jnp.asarray(spec.action_high)

    def collect(handle: Handle, start: Seed, params: Params, draws: Draws) -> tuple[Handle, Seed, Trace]:
        def step(carry: tuple[Handle, Seed], draw: Draws) -> tuple[tuple[Handle, Seed], Trace]:
            handle, before = carry
            env_state, statistics = before
            acted = _act(config, params, before, draw)
            handle, stepped = world.step(handle, jnp.clip(acted[1].astype(jnp.float64), low, high))
            counters = _count(config, env_state, stepped.rewards)
            done = _ends(stepped, counters).done
            # Resets leave the program, so they are paid for only when an episode ends.
            fresh = jax.lax.cond(
                done.any(),
                lambda: jnp.where(done[:, None], world.reset(done), stepped.observations),
                lambda: stepped.observations,
            )
            horizons = config.protocol.horizon.from_uniform(draw.horizon)
            now = EnvState(fresh, jnp.where(done, _restart(horizons), counters))
            seen = Statistics(
                update_moments(config, statistics.observations, now), merge(statistics.returns, counters[2][:, None])
            )
            return (handle, (now, seen)), _trace(acted, stepped, counters, seen)

        (handle, last), traced = jax.lax.scan(step, (handle, start), draws)
        return handle, last, traced

    return collect


def draw(key: jax.Array, action_size: int, *, config: PPOConfig) -> Draws:
    """Return all random numbers of one seed's rollout; to be compiled under x64."""
    noise_key, horizon_key = jax.random.split(key)
    shape = (config.n_steps, config.n_envs)
    noise = jax.random.normal(noise_key, (*shape, action_size), jnp.float32)
    return Draws(noise, jax.random.uniform(horizon_key, shape, jnp.float64))


def finish(seed: Seed, trace: Trace, *, config: PPOConfig) -> SeedRollout:
    """Return the results of one seed's trace, for all steps at once; to be compiled under x64."""
    env_state, statistics = seed
    elapsed, horizons, _, returns = (trace.counters[:, row] for row in range(4))
    rewards, terminated, truncated = (trace.step_result[:, row] for row in range(3))
    ends = Ends(terminated > 0, truncated > 0, elapsed >= horizons)
    moments = RunningMoments(trace.moments[:, :1], trace.moments[:, 1:], statistics.observations.count)
    experience = Experience(
        inputs=jnp.concatenate([trace.inputs, _inputs(config, env_state, statistics)[None]]),
        last_inputs=network_inputs(config, moments, trace.observations, elapsed, horizons),
        actions=trace.actions,
        rewards=scale_rewards(trace.return_var, rewards),
        ends=ends,
        return_std=jnp.sqrt(trace.return_var + EPSILON).astype(jnp.float32),
    )
    return SeedRollout(env_state, statistics, experience, Episodes(returns, elapsed, ends.done))


def _inputs(config: PPOConfig, env_state: EnvState, statistics: Statistics) -> jax.Array:
    return network_inputs(
        config, statistics.observations, env_state.observations, env_state.elapsed, env_state.horizons
    )


def _act(
    config: PPOConfig, params: Params, before: tuple[EnvState, Statistics], draw: Draws
) -> tuple[jax.Array, jax.Array]:
    inputs = _inputs(config, *before)
    mean = forward(params, "policy", inputs, config.activation)
    return inputs, mean + jnp.exp(params["log_std"]) * draw.noise


def _count(config: PPOConfig, env_state: EnvState, rewards: jax.Array) -> jax.Array:
    gamma = config.protocol.normalizer_gamma
    return jnp.stack(
        [env_state.elapsed + 1, env_state.horizons, env_state.discounted * gamma + rewards, env_state.returns + rewards]
    )


def _restart(horizons: jax.Array) -> jax.Array:
    zeros = jnp.zeros_like(horizons)
    return jnp.stack([zeros, horizons, zeros, zeros])


def _ends(step: TracedStep, counters: jax.Array) -> Ends:
    return Ends(step.terminated, step.truncated, counters[0] >= counters[1])


def _trace(acted: tuple[jax.Array, jax.Array], step: TracedStep, counters: jax.Array, statistics: Statistics) -> Trace:
    return Trace(
        inputs=acted[0],
        actions=acted[1],
        observations=step.observations,
        counters=counters,
        step_result=jnp.stack([step.rewards, step.terminated, step.truncated]),
        moments=jnp.stack([statistics.observations.mean, statistics.observations.var]),
        return_var=statistics.returns.var,
    )
