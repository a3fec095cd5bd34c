"""Advantage estimators by name: discounted (GAE) and average reward.

An estimator turns rollouts into advantages and targets of the value network. Its state is a tree of arrays, which the
checkpoint saves without knowing it.
"""

from __future__ import annotations

from dataclasses import MISSING, dataclass, fields
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, Self

import jax
import jax.numpy as jnp

from perdure.errors import PerdureError, lookup

if TYPE_CHECKING:
    from perdure.learn.config import PPOConfig

EstimatorState = Any
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

    def start(self) -> EstimatorState:
        """Return the state before the first rollout."""

    def estimate(self, state: EstimatorState, transitions: Transitions) -> tuple[EstimatorState, Estimate]:
        """Return the next state and the estimates of one rollout; traced by JAX."""


@dataclass(frozen=True)
class Discounted:
    """GAE of the discounted return; of the undiscounted return within the horizon where gamma is 1.

    Schulman et al., High-dimensional continuous control using generalized advantage estimation (2016), eq. 16, with

        delta_t = r_t + gamma V'_t - V(s_t)
        A_t     = delta_t + gamma lambda (1 - done_t) A_{t+1}

    where V'_t, the value of what follows step t, is

        0           if the task ended, or if the horizon ended and its end means ``terminated``
        V(last_t)   if the episode was cut: ``last_t`` is the observation it stopped at, not the one after the reset
        V(s_{t+1})  otherwise
    """

    gamma: float
    gae_lambda: float
    horizon_terminates: bool
    """Whether reaching the horizon counts as the task's own end."""

    @classmethod
    def of(cls, config: PPOConfig) -> Self:
        """Return the estimator of a configuration."""
        return cls(config.protocol.gamma, config.gae_lambda, config.protocol.end == "terminated")

    def start(self) -> EstimatorState:
        """Return nothing: every rollout stands for itself."""
        return ()

    def estimate(self, state: EstimatorState, transitions: Transitions) -> tuple[EstimatorState, Estimate]:
        """See `Estimator.estimate`."""
        rewards, values, last_values, ends, _ = transitions
        terminal = ends.terminated
        if self.horizon_terminates:
            terminal = terminal | ends.horizon_end
        following = jnp.where(terminal, 0.0, jnp.where(ends.done, last_values, values[1:]))
        deltas = rewards + self.gamma * following - values[:-1]
        found = sum_traces(deltas, self.gamma * self.gae_lambda * (1.0 - ends.done.astype(rewards.dtype)))
        return state, Estimate(found, found + values[:-1])


@dataclass(frozen=True)
class AverageReward:
    """Advantages of the average reward.

    The differential value V(s) is how much more reward follows s than follows on average. With rho the average reward,

        delta_t = r_t - rho + V'_t - V(s_t)
        A_t     = delta_t + lambda A_{t+1}

    as in Zhang and Ross, On-policy deep reinforcement learning for the average-reward criterion (2021). As there, a
    fall does not end anything: it costs `reset_cost`, and the next start state follows it. So V'_t = V(s_{t+1}) and the
    trace runs on. Where an episode was cut, V'_t = V(last_t) and the trace ends.

    From Ma et al., Average-reward reinforcement learning with trust region methods (2021): rho is a moving average over
    rollouts, rho <- (1 - alpha) rho + alpha mean(r). V is determined only up to a constant, so it may drift; the
    average value constraint pulls its mean b to 0: the value network is fitted to V(s_t) + A_t - nu b.

    Raises:
        PerdureError: If a number is out of its range.
    """

    gae_lambda: float
    alpha: float = 0.1
    """Weight of the newest rollout in the moving averages; at least 1 / n at the n-th rollout."""
    nu: float = 0.3
    """Strength of the average value constraint, from 0 to 1."""
    reset_cost: float = 100.0
    """What a fall costs, in units of the task's reward (Zhang and Ross: 100)."""

    def __post_init__(self) -> None:
        for name, low, value in (("alpha", 1e-6, self.alpha), ("nu", 0.0, self.nu)):
            if not low <= value <= 1:
                raise PerdureError(f"{name} of average-reward is {value!r}; it must be a number from {low} to 1")
        if not 0 <= self.reset_cost < float("inf"):
            raise PerdureError(f"reset_cost of average-reward is {self.reset_cost!r}; it must be 0 or more")

    @classmethod
    def of(cls, config: PPOConfig, **numbers: float) -> Self:
        """Return the estimator of a configuration.

        Raises:
            PerdureError: The protocol discounts, or calls reaching the horizon an end: neither has a meaning here.
        """
        found = cls(config.gae_lambda, **numbers)
        for name, value, meant in (("end", config.protocol.end, "truncated"), ("gamma", config.protocol.gamma, 1.0)):
            if value != meant:
                raise PerdureError(f"average-reward needs protocol.{name} {meant!r}, got {value!r}")
        return found

    def start(self) -> AverageRewardState:
        """Return moving averages of nothing."""
        zero = jnp.zeros((), jnp.float32)
        return AverageRewardState(zero, zero, zero)

    def estimate(self, state: AverageRewardState, transitions: Transitions) -> tuple[AverageRewardState, Estimate]:
        """See `Estimator.estimate`."""
        values = transitions.values
        ends = transitions.ends
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


class AverageRewardState(NamedTuple):
    """Moving averages over rollouts; scalars, float32."""

    rate: jax.Array
    """rho: scaled reward per step, the cost of falls included."""
    value: jax.Array
    """b: mean of V."""
    rollouts: jax.Array
    """Rollouts seen."""


ESTIMATORS: dict[str, type[Any]] = {"discounted": Discounted, "average-reward": AverageReward}
"""Name to a dataclass whose `of` (config, **numbers) returns an `Estimator`."""


def make_estimator(config: PPOConfig) -> Estimator:
    """Return the estimator that a configuration names.

    Raises:
        PerdureError: If there is no such estimator, or it has no such number.
    """
    name, _, text = config.estimator.partition(":")
    kind = lookup(ESTIMATORS, name, "estimator")
    valid = [each.name for each in fields(kind) if each.default is not MISSING]
    numbers: dict[str, float] = {}
    for part in filter(None, text.split(",")):
        key, _, value = part.partition("=")
        if key not in valid:
            known = f"the numbers of {name} are {', '.join(valid)}" if valid else f"{name} has no numbers"
            raise PerdureError(f"unknown number {key!r} in estimator {config.estimator!r}; {known}")
        try:
            numbers[key] = float(value)
        except ValueError:
            raise PerdureError(f"{part!r} in estimator {config.estimator!r} must be written name=number") from None
    estimator: Estimator = kind.of(config, **numbers)
    return estimator


def sum_traces(deltas: jax.Array, decay: jax.Array) -> jax.Array:
    """Return A_t = delta_t + decay_t A_{t+1}, with A = 0 after the last row; shapes (n_steps, n_envs)."""

    def backwards(later: jax.Array, step: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        delta, weight = step
        now = delta + weight * later
        return now, now

    _, result = jax.lax.scan(backwards, jnp.zeros_like(deltas[0]), (deltas, decay), reverse=True)
    return result
