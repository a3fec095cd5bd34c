"""Generalized advantage estimation that distinguishes the four ways a step can end or continue.

Schulman et al., High-dimensional continuous control using generalized advantage estimation (2016), eq. 16, with

    delta_t = r_t + gamma V'_t - V(s_t)
    A_t     = delta_t + gamma lambda (1 - done_t) A_{t+1}

where V'_t, the value of what follows step t, is

    0           if the task ended, or if the horizon ended and its end means ``terminated``
    V(last_t)   if the episode was cut: ``last_t`` is the observation it stopped at, not the one after the reset
    V(s_{t+1})  otherwise
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Self

import jax
import jax.numpy as jnp

from perdure.ppo.estimators.estimator import Ends, Estimate, State, Transitions, sum_traces

if TYPE_CHECKING:
    from perdure.ppo.config import PPOConfig


@dataclass(frozen=True)
class Discounted:
    """GAE of the discounted return; of the undiscounted return within the horizon where gamma is 1."""

    gamma: float
    gae_lambda: float
    horizon_terminates: bool
    """Whether reaching the horizon counts as the task's own end."""

    @classmethod
    def of(cls, config: PPOConfig) -> Self:
        """Return the estimator of a configuration."""
        return cls(config.protocol.gamma, config.gae_lambda, config.protocol.end == "terminated")

    def start(self) -> State:
        """Return nothing: every rollout stands for itself."""
        return ()

    def estimate(self, state: State, transitions: Transitions) -> tuple[State, Estimate]:
        """See `Estimator.estimate`."""
        rewards, values, last_values, ends, _ = transitions
        following = following_values(values, last_values, ends, self.horizon_terminates)
        found = advantages(rewards, values[:-1], following, ends.done, self.gamma, self.gae_lambda)
        return state, Estimate(found, found + values[:-1])


def following_values(values: jax.Array, last_values: jax.Array, ends: Ends, horizon_terminates: bool) -> jax.Array:
    """Return V'_t for every step.

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
    """Return A_t for every step; all arrays have shape (n_steps, n_envs)."""
    deltas = rewards + gamma * following - values
    return sum_traces(deltas, gamma * gae_lambda * (1.0 - done.astype(rewards.dtype)))
