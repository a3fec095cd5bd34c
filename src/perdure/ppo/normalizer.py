"""Running normalization of observations and rewards, as Stable-Baselines3's ``VecNormalize`` does it.

Statistics are kept in float64 and merged by the parallel rule of Chan, Golub and LeVeque (1979).
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp

CLIP = 10.0
"""Both observations and rewards are clipped to +-CLIP after scaling."""
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


def normalize(moments: RunningMoments, values: jax.Array) -> jax.Array:
    """Return (values - mean) / sqrt(var + eps), clipped; float32, shape of ``values``."""
    scaled = (values - moments.mean) / jnp.sqrt(moments.var + EPSILON)
    return jnp.clip(scaled, -CLIP, CLIP).astype(jnp.float32)


def scale_rewards(return_var: jax.Array, rewards: jax.Array) -> jax.Array:
    """Return rewards divided by the running discounted return's standard deviation; clipped, float32."""
    return jnp.clip(rewards / jnp.sqrt(return_var + EPSILON), -CLIP, CLIP).astype(jnp.float32)
