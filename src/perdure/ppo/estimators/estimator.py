"""Interface of advantage estimators: they turn a rollout into advantages and value targets, and may keep a state.

The state is a tree of arrays. It is saved in every checkpoint without being named anywhere else.
"""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol

import jax
import jax.numpy as jnp

State = Any
"""A tree of arrays, such as a named tuple; () for an estimator that remembers nothing."""


class Ends(NamedTuple):
    """What ended at each step. Each field has shape (n_steps, n_envs), bool; more than one may be true."""

    terminated: jax.Array
    truncated: jax.Array
    horizon_end: jax.Array

    @property
    def done(self) -> jax.Array:
        """The episode ended with this step."""
        return self.terminated | self.truncated | self.horizon_end


class Transitions(NamedTuple):
    """A rollout, the input of an estimator. Unless stated otherwise the shape is (n_steps, n_envs)."""

    rewards: jax.Array
    """Scaled rewards r_t."""
    values: jax.Array
    """V(s_t), shape (n_steps + 1, n_envs). The last row belongs to the state after the rollout. Row t + 1 belongs to
    the state after the reset where an episode ended at step t."""
    last_values: jax.Array
    """V of the state that step t led to, before any reset."""
    ends: Ends
    return_std: jax.Array
    """What rewards were divided by, shape (n_steps, 1)."""


class Estimate(NamedTuple):
    """Shape (n_steps, n_envs) each."""

    advantages: jax.Array
    targets: jax.Array
    """What the value network is fitted to."""


class Estimator(Protocol):
    """Turns rollouts into advantages. Implementations are immutable; what changes is the state they are given."""

    def start(self) -> State:
        """Return the state before the first rollout."""

    def estimate(self, state: State, transitions: Transitions) -> tuple[State, Estimate]:
        """Return the next state and the estimates of one rollout; traced by JAX."""


def sum_traces(deltas: jax.Array, decay: jax.Array) -> jax.Array:
    """Return A_t = delta_t + decay_t A_{t+1}, with A = 0 after the last row; shapes (n_steps, n_envs)."""

    def backwards(later: jax.Array, step: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        delta, weight = step
        now = delta + weight * later
        return now, now

    _, result = jax.lax.scan(backwards, jnp.zeros_like(deltas[0]), (deltas, decay), reverse=True)
    return result
