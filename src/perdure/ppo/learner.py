"""From a rollout to better weights: values, advantages, then epochs of minibatches."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import jax
import jax.numpy as jnp

from perdure.ppo.advantages import advantages, following_values
from perdure.ppo.networks import Params, forward, log_prob
from perdure.ppo.update import Batch

if TYPE_CHECKING:
    from perdure.ppo.config import PPOConfig
    from perdure.ppo.rollout import Experience


class Prepared(NamedTuple):
    """A rollout ready to be learned from."""

    batch: Batch
    orders: tuple[jax.Array, ...]
    """One permutation of the transitions for each epoch, (n,)."""
    explained_variance: jax.Array
    """1 - Var(returns - values) / Var(returns) before the update."""


def prepare(params: Params, experience: Experience, key: jax.Array, *, config: PPOConfig) -> Prepared:
    """Values, advantages, targets and log probabilities of a whole rollout at once.

    The weights did not change while the rollout was collected, so nothing but actions had to be computed then.
    """
    n = config.rollout_size

    def values_of(inputs: jax.Array) -> jax.Array:
        flat = inputs.reshape(-1, inputs.shape[-1])
        return forward(params, "value", flat, config.activation)[:, 0].reshape(inputs.shape[:-1])

    values = values_of(experience.inputs)
    following = following_values(
        values, values_of(experience.last_inputs), experience.ends, config.protocol.end == "terminated"
    )
    estimates = advantages(
        experience.rewards, values[:-1], following, experience.ends.done, config.protocol.gamma, config.gae_lambda
    )
    inputs = experience.inputs[:-1].reshape(n, -1)
    actions = experience.actions.reshape(n, -1)
    mean = forward(params, "policy", inputs, config.activation)
    returns = estimates + values[:-1]
    batch = Batch(inputs, actions, log_prob(mean, params["log_std"], actions), estimates.reshape(n), returns.reshape(n))
    orders = tuple(jax.random.permutation(jax.random.fold_in(key, i), n) for i in range(config.n_epochs))
    unexplained = jnp.var(returns - values[:-1]) / jnp.maximum(jnp.var(returns), 1e-12)
    return Prepared(batch, orders, 1.0 - unexplained)
