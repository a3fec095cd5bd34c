"""Policy and value networks, and the running normalization of observations and rewards.

Two separate multilayer perceptrons, and a Gaussian whose standard deviation does not depend on the observation.

This is Stable-Baselines3's ``MlpPolicy``. Parameters are a flat dictionary, so that a file of them can be read by eye:
``policy.0.weight`` (in, out), ``policy.0.bias`` (out,), ..., ``value.2.weight``, ``log_std`` (action_size,).

phi is appended to the observation. With ``conditioning="film"`` the first layer takes the observation only, and every
hidden layer becomes act((1 + phi @ scale) * (h @ weight + bias) + phi @ shift), with ``policy.0.scale`` and
``policy.0.shift`` of shape (embedding_size, out) (feature-wise linear modulation; Perez et al., 2018). Both start at
zero, so the networks begin as those of a policy without phi.

With ``conditioning="critic"`` only the value network sees phi: the rows of the policy's first layer that take it are
zero and stay zero, see `actor_inputs`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import jax
import jax.numpy as jnp

if TYPE_CHECKING:
    from perdure.learn.config import PPOConfig

Params = dict[str, jax.Array]

LOG_SQRT_2PI = 0.5 * math.log(2.0 * math.pi)
ACTIVATIONS: dict[str, Callable[[jax.Array], jax.Array]] = {
    "relu": jax.nn.relu,
    "tanh": jnp.tanh,
    "elu": jax.nn.elu,
    "selu": jax.nn.selu,
    "leaky_relu": jax.nn.leaky_relu,
    "sigmoid": jax.nn.sigmoid,
    "silu": jax.nn.silu,
    "gelu": partial(jax.nn.gelu, approximate=False),
    "softplus": jax.nn.softplus,
    "mish": jax.nn.mish,
}
"""The same functions as `perdure.policy.network.ACTIVATIONS`, which act when the policy is deployed."""


def init_params(key: jax.Array, input_size: int, action_size: int, config: PPOConfig) -> Params:
    """Return initial weights of both networks, float32.

    Orthogonal with gain sqrt(2) in the hidden layers, 0.01 for the action mean and 1 for the value (Stable-Baselines3),
    or uniform in +-1/sqrt(fan in) for weights and biases (torch's ``Linear``) when ``config.ortho_init`` is off.
    ``input_size`` is that of observation and phi together.
    """
    modulating = 0
    if config.conditioning == "film":
        modulating = config.protocol.embedding_size
    params: Params = {"log_std": jnp.full((action_size,), config.log_std_init, jnp.float32)}
    for name, out_size, out_gain in (("policy", action_size, 0.01), ("value", 1, 1.0)):
        key, net_key = jax.random.split(key)
        sizes = (input_size - modulating, *config.hidden_sizes, out_size)
        for layer, (fan_in, fan_out) in enumerate(pairwise(sizes)):
            gain = out_gain if layer == len(sizes) - 2 else math.sqrt(2.0)
            layer_key = jax.random.fold_in(net_key, layer)
            weight, bias = _init_layer(layer_key, fan_in, fan_out, gain, config.ortho_init)
            if config.conditioning == "critic" and name == "policy" and layer == 0:
                weight = weight.at[input_size - config.protocol.embedding_size :].set(0.0)
            params[f"{name}.{layer}.weight"] = weight
            params[f"{name}.{layer}.bias"] = bias
            if modulating and layer < len(sizes) - 2:
                for part in ("scale", "shift"):
                    params[f"{name}.{layer}.{part}"] = jnp.zeros((modulating, fan_out), jnp.float32)
    return params


def _init_layer(
    key: jax.Array, fan_in: int, fan_out: int, gain: float, orthogonal: bool
) -> tuple[jax.Array, jax.Array]:
    if orthogonal:
        weight = jax.nn.initializers.orthogonal(gain)(key, (fan_in, fan_out), jnp.float32)
        return weight, jnp.zeros((fan_out,), jnp.float32)
    bound = 1.0 / math.sqrt(fan_in)
    weight_key, bias_key = jax.random.split(key)
    weight = jax.random.uniform(weight_key, (fan_in, fan_out), jnp.float32, -bound, bound)
    return weight, jax.random.uniform(bias_key, (fan_out,), jnp.float32, -bound, bound)


def forward(params: Params, network: str, inputs: jax.Array, activation: str) -> jax.Array:
    """Return the output of ``network`` ("policy" or "value"), shape (n, outputs), for inputs (n, input_size)."""
    layers = sum(name.startswith(f"{network}.") and name.endswith(".weight") for name in params)
    activate = ACTIVATIONS[activation]
    first = len(params[f"{network}.0.weight"])
    hidden = inputs[:, :first]
    phi = inputs[:, first:]
    for layer in range(layers):
        hidden = hidden @ params[f"{network}.{layer}.weight"] + params[f"{network}.{layer}.bias"]
        if layer < layers - 1:
            if f"{network}.{layer}.scale" in params:
                scale, shift = (params[f"{network}.{layer}.{part}"] for part in ("scale", "shift"))
                hidden = (1.0 + phi @ scale) * hidden + phi @ shift
            hidden = activate(hidden)
    return hidden


def actor_inputs(inputs: jax.Array, config: PPOConfig) -> jax.Array:
    """Return the inputs with which the policy network learns: without phi where only the critic sees it."""
    if config.conditioning == "critic":
        return inputs.at[:, inputs.shape[1] - config.protocol.embedding_size :].set(0.0)
    return inputs


def log_prob(mean: jax.Array, log_std: jax.Array, actions: jax.Array) -> jax.Array:
    """Return the log density of a diagonal Gaussian, summed over actions: (n, a), (a,), (n, a) -> (n,)."""
    z = (actions - mean) * jnp.exp(-log_std)
    return (-0.5 * jnp.square(z) - log_std - LOG_SQRT_2PI).sum(axis=-1)


def entropy(log_std: jax.Array) -> jax.Array:
    """Return the Gaussian's entropy in nats, the same for all states: sum_i (1/2 + log sqrt(2 pi) + log std_i)."""
    return (0.5 + LOG_SQRT_2PI + log_std).sum()


# Running normalization, as in Stable-Baselines3's ``VecNormalize``. Statistics are kept in float64 and merged by the
# parallel rule of Chan, Golub and LeVeque (1979).

CLIP = 10.0
"""Rewards are clipped to +-CLIP after scaling; observations too, unless `PPOConfig.clip_obs` says otherwise."""
EPSILON = 1e-8
"""Added to a variance before its square root."""


class RunningMoments(NamedTuple):
    """Mean and population variance of everything seen so far."""

    mean: jax.Array
    """Shape (d,), float64."""
    var: jax.Array
    """Shape (d,), float64."""
    count: jax.Array  # type: ignore[assignment]  # hides tuple.count, which nobody needs here
    """Scalar, float64; starts at 1e-4 so that the start values hardly count."""


def start_moments(size: int) -> RunningMoments:
    """Return moments with mean 0, variance 1 and almost no weight."""
    return RunningMoments(
        jnp.zeros((size,), jnp.float64), jnp.ones((size,), jnp.float64), jnp.asarray(1e-4, jnp.float64)
    )


def merge(moments: RunningMoments, batch: jax.Array) -> RunningMoments:
    """Return the moments, updated with the rows of ``batch``, shape (n, d)."""
    n = batch.shape[0]
    batch_mean = batch.mean(axis=0)
    batch_var = jnp.square(batch - batch_mean).mean(axis=0)
    total = moments.count + n
    delta = batch_mean - moments.mean
    mean = moments.mean + delta * (n / total)
    squares = moments.var * moments.count + batch_var * n + jnp.square(delta) * (moments.count * n / total)
    return RunningMoments(mean, squares / total, total)


def normalize(moments: RunningMoments, values: jax.Array, clip: float = CLIP) -> jax.Array:
    """Return (values - mean) / sqrt(var + eps), clipped to +-clip; float32, shape of ``values``."""
    scaled = (values - moments.mean) / jnp.sqrt(moments.var + EPSILON)
    return jnp.clip(scaled, -clip, clip).astype(jnp.float32)


def scale_rewards(return_var: jax.Array, rewards: jax.Array) -> jax.Array:
    """Return rewards divided by the running discounted return's standard deviation; clipped, float32."""
    return jnp.clip(rewards / jnp.sqrt(return_var + EPSILON), -CLIP, CLIP).astype(jnp.float32)
