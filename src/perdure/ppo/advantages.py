"""Generalised advantage estimation with the four ways a step can be followed kept apart.

Schulman et al., High-dimensional continuous control using generalized advantage estimation (2016), eq. 16, with

    delta_t = r_t + gamma V'_t - V(s_t)
    A_t     = delta_t + gamma lambda (1 - done_t) A_{t+1}

where V'_t, the value of what follows step t, is

    0           if the task ended, or if the horizon ended and its end means ``terminated``
    V(last_t)   if the episode was cut: ``last_t`` is the observation it stopped at, not the one after the reset
    V(s_{t+1})  otherwise
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp


class Ends(NamedTuple):
    """What ended at each step. Each field has shape (n_steps, n_envs), bool; more than one may be true."""

    terminated: jax.Array
    truncated: jax.Array
    horizon_end: jax.Array

    @property
    def done(self) -> jax.Array:
        """The trace is cut after this step."""
        return self.terminated | self.truncated | self.horizon_end


def following_values(values: jax.Array, last_values: jax.Array, ends: Ends, horizon_terminates: bool) -> jax.Array:
    """V'_t for every step.

    Args:
        values: V(s_t), with V of the state after the rollout as last row; shape (n_steps + 1, n_envs).
        last_values: V(last_t), used where an episode was cut; shape (n_steps, n_envs).
        ends: What ended at each step.
        horizon_terminates: True if reaching the horizon counts as the task's own end.

    Returns:
        Shape (n_steps, n_envs).
    """
    terminal = ends.terminated | ends.horizon_end if horizon_terminates else ends.terminated
    bootstrapped = jnp.where(ends.done, last_values, values[1:])
    return jnp.where(terminal, 0.0, bootstrapped)


def advantages(
    rewards: jax.Array, values: jax.Array, following: jax.Array, done: jax.Array, gamma: float, gae_lambda: float
) -> jax.Array:
    """A_t for every step; all arrays have shape (n_steps, n_envs)."""
    deltas = rewards + gamma * following - values
    decay = gamma * gae_lambda * (1.0 - done.astype(rewards.dtype))

    def backwards(later: jax.Array, step: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        delta, weight = step
        now = delta + weight * later
        return now, now

    _, result = jax.lax.scan(backwards, jnp.zeros_like(deltas[0]), (deltas, decay), reverse=True)
    return result
