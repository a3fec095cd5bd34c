"""Advantages of the average reward per step: no discount, and no horizon.

The differential value V(s) is how much more reward follows s than follows on average. With rho the average reward,

    delta_t = r_t - rho + V'_t - V(s_t)
    A_t     = delta_t + lambda A_{t+1}

as in Zhang and Ross, On-policy deep reinforcement learning for the average-reward criterion (2021). As there, a fall
does not end anything: it costs `reset_cost`, and the next start state follows it. So V'_t = V(s_{t+1}) and the trace
runs on. Where an episode was cut, V'_t = V(last_t) and the trace ends.

From Ma et al., Average-reward reinforcement learning with trust region methods (2021): rho is a moving average over
rollouts, rho <- (1 - alpha) rho + alpha mean(r). V is determined only up to a constant, so it may drift; the average
value constraint pulls its mean b to 0: the value network is fitted to V(s_t) + A_t - nu b.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple, Self

import jax
import jax.numpy as jnp

from perdure.ppo.errors import ConfigError
from perdure.ppo.estimators.estimator import Estimate, Transitions, sum_traces

if TYPE_CHECKING:
    from perdure.ppo.config import PPOConfig


class AverageRewardState(NamedTuple):
    """Moving averages over rollouts; scalars, float32."""

    rate: jax.Array
    """rho: scaled reward per step, the cost of falls included."""
    value: jax.Array
    """b: mean of V."""
    rollouts: jax.Array
    """Rollouts seen."""


@dataclass(frozen=True)
class AverageReward:
    """Advantages of the average reward.

    Raises:
        ConfigError: If a number is out of its range.
    """

    gae_lambda: float
    alpha: float = 0.1
    """Weight of the newest rollout in the moving averages; at least 1 / n at the n-th rollout."""
    nu: float = 0.3
    """Strength of the average value constraint, from 0 to 1."""
    reset_cost: float = 100.0
    """What a fall costs, in units of the task's reward (Zhang and Ross: 100)."""

    def __post_init__(self) -> None:
        """Refuse numbers that no estimate can be made with."""
        for name, low, value in (("alpha", 1e-6, self.alpha), ("nu", 0.0, self.nu)):
            if not low <= value <= 1:
                raise ConfigError(f"{name} of average-reward is {value!r}; it must be a number from {low} to 1")
        if not 0 <= self.reset_cost < float("inf"):
            raise ConfigError(f"reset_cost of average-reward is {self.reset_cost!r}; it must be 0 or more")

    @classmethod
    def of(cls, config: PPOConfig, **numbers: float) -> Self:
        """Return the estimator of a configuration.

        Raises:
            ConfigError: The protocol discounts, or calls reaching the horizon an end: neither has a meaning here.
        """
        found = cls(config.gae_lambda, **numbers)
        for name, value, meant in (("end", config.protocol.end, "truncated"), ("gamma", config.protocol.gamma, 1.0)):
            if value != meant:
                raise ConfigError(f"average-reward needs protocol.{name} {meant!r}, got {value!r}")
        return found

    def start(self) -> AverageRewardState:
        """Return moving averages of nothing."""
        zero = jnp.zeros((), jnp.float32)
        return AverageRewardState(zero, zero, zero)

    def estimate(self, state: AverageRewardState, transitions: Transitions) -> tuple[AverageRewardState, Estimate]:
        """See `Estimator.estimate`."""
        values, ends = transitions.values, transitions.ends
        cost = jnp.where(ends.terminated, self.reset_cost / transitions.return_std, 0.0)
        rewards = (transitions.rewards - cost).astype(values.dtype)
        weight = jnp.maximum(self.alpha, 1.0 / (state.rollouts + 1.0))
        now = AverageRewardState(
            (1 - weight) * state.rate + weight * rewards.mean(),
            (1 - weight) * state.value + weight * values[:-1].mean(),
            state.rollouts + 1.0,
        )
        cut = ends.done & ~ends.terminated
        following = jnp.where(cut, transitions.last_values, values[1:])
        deltas = rewards - now.rate + following - values[:-1]
        advantages = sum_traces(deltas, self.gae_lambda * (1.0 - cut.astype(values.dtype)))
        return now, Estimate(advantages, advantages + values[:-1] - self.nu * now.value)
