"""The PPO update: clipped loss, gradient clipping, Adam, minibatches.

Schulman et al., Proximal policy optimization algorithms (2017), eq. 7 and 9, with the details of Stable-Baselines3:
advantages normalized in each minibatch (unbiased standard deviation), squared value error without clipping, Adam with
epsilon 1e-5 (Kingma and Ba, 2015).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import jax
import jax.numpy as jnp

from perdure.ppo.networks import Params, entropy, forward, log_prob

if TYPE_CHECKING:
    from perdure.ppo.config import PPOConfig

ADAM_BETA1 = 0.9
ADAM_BETA2 = 0.999
ADAM_EPSILON = 1e-5
CLIP_NORM_EPSILON = 1e-6


class AdamState(NamedTuple):
    """First and second moments of the gradient, and the number of updates so far."""

    first: Params
    second: Params
    count: jax.Array  # type: ignore[assignment]  # hides tuple.count, which nobody needs here


class Batch(NamedTuple):
    """Transitions to learn from; the leading axis is n."""

    inputs: jax.Array
    """What the networks saw: normalized observation and phi, (n, input_size)."""
    actions: jax.Array
    """As sampled, before clipping to the action box, (n, action_size)."""
    log_probs: jax.Array
    """Under the policy that acted, (n,)."""
    advantages: jax.Array
    """(n,)."""
    returns: jax.Array
    """Targets of the value network, (n,)."""


LOSSES = ("policy_loss", "value_loss", "approx_kl", "clip_fraction")
"""What a minibatch reports, in the order of the vector that carries it."""


def start_adam(params: Params) -> AdamState:
    """Return zero moments."""
    return AdamState(
        jax.tree.map(jnp.zeros_like, params), jax.tree.map(jnp.zeros_like, params), jnp.zeros((), jnp.int32)
    )


def loss(params: Params, batch: Batch, config: PPOConfig) -> tuple[jax.Array, jax.Array]:
    """Return the loss of one minibatch (surrogate, entropy bonus, squared value error), and LOSSES, shape (4,)."""
    advantages = batch.advantages
    if advantages.shape[0] > 1:
        advantages = (advantages - advantages.mean()) / (advantages.std(ddof=1) + 1e-8)
    mean = forward(params, "policy", batch.inputs, config.activation)
    values = forward(params, "value", batch.inputs, config.activation)[:, 0]
    log_ratio = log_prob(mean, params["log_std"], batch.actions) - batch.log_probs
    ratio = jnp.exp(log_ratio)
    clipped = jnp.clip(ratio, 1 - config.clip_range, 1 + config.clip_range)
    policy_loss = -jnp.minimum(advantages * ratio, advantages * clipped).mean()
    value_loss = jnp.square(batch.returns - values).mean()
    total = policy_loss - config.ent_coef * entropy(params["log_std"]) + config.vf_coef * value_loss
    clip_fraction = (jnp.abs(ratio - 1) > config.clip_range).astype(jnp.float32).mean()
    return total, jnp.stack([policy_loss, value_loss, (ratio - 1 - log_ratio).mean(), clip_fraction])


def adam_step(
    params: Params, state: AdamState, gradient: Params, learning_rate: jax.Array | float, max_grad_norm: float
) -> tuple[Params, AdamState]:
    """Make one Adam step along the gradient cut to ``max_grad_norm``.

    The bias corrections are folded into the step size and epsilon (Kingma and Ba, section 2, last paragraph), which
    leaves one division and one square root for each weight.
    """
    norm = jnp.sqrt(sum((jnp.vdot(g, g) for g in jax.tree.leaves(gradient)), start=jnp.zeros(())))
    scale = jnp.minimum(1.0, max_grad_norm / (norm + CLIP_NORM_EPSILON))
    count = state.count + 1
    steps = count.astype(jnp.float32)
    correction = jnp.sqrt(1 - ADAM_BETA2**steps)
    step_size = learning_rate * correction / (1 - ADAM_BETA1**steps)
    epsilon = ADAM_EPSILON * correction
    first_weight = (1 - ADAM_BETA1) * scale
    second_weight = (1 - ADAM_BETA2) * jnp.square(scale)
    first = jax.tree.map(lambda m, g: ADAM_BETA1 * m + first_weight * g, state.first, gradient)
    second = jax.tree.map(lambda v, g: ADAM_BETA2 * v + second_weight * (g * g), state.second, gradient)
    params = jax.tree.map(lambda p, m, v: p - step_size * m / (jnp.sqrt(v) + epsilon), params, first, second)
    return params, AdamState(first, second, count)


def epoch(
    params: Params, adam: AdamState, batch: Batch, order: jax.Array, config: PPOConfig
) -> tuple[Params, AdamState, jax.Array]:
    """Make one pass over a rollout.

    Args:
        params: Weights before.
        adam: Optimizer state before.
        batch: The whole rollout, n transitions.
        order: A permutation of range(n), shape (n,): consecutive slices of it are the minibatches.
        config: The learner's settings.

    Returns:
        Weights and optimizer state after, and the mean LOSSES of the minibatches, (4,).
    """

    def minibatch(carry: tuple[Params, AdamState], indices: jax.Array) -> tuple[tuple[Params, AdamState], jax.Array]:
        params, adam = carry
        picked = jax.tree.map(lambda x: x[indices], batch)
        gradient, losses = jax.grad(loss, has_aux=True)(params, picked, config)
        return adam_step(params, adam, gradient, _step_size(config, adam.count), config.max_grad_norm), losses

    (params, adam), losses = jax.lax.scan(minibatch, (params, adam), order.reshape(-1, config.batch_size))
    if config.log_std_end is not None:
        params = {**params, "log_std": jnp.minimum(params["log_std"], _log_std_ceiling(config, adam.count))}
    return params, adam, losses.mean(axis=0)


def _step_size(config: PPOConfig, count: jax.Array) -> jax.Array | float:
    """Return Adam's step size after ``count`` steps."""
    if config.learning_rate_decay == "none":
        return config.learning_rate
    return config.learning_rate * (1 - (_iteration(config, count) + 1) / config.iterations)


def _log_std_ceiling(config: PPOConfig, count: jax.Array) -> jax.Array:
    """Return the largest log standard deviation after ``count`` Adam steps."""
    assert config.log_std_end is not None
    begin, end = config.log_std_fall
    share = jnp.clip((_iteration(config, count) / config.iterations - begin) / (end - begin), 0.0, 1.0)
    return config.log_std_init + share * (config.log_std_end - config.log_std_init)


def _iteration(config: PPOConfig, count: jax.Array) -> jax.Array:
    return count // (config.n_epochs * (config.rollout_size // config.batch_size))
