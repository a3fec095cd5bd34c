"""Activation functions in NumPy, entry by entry, so that a row's result does not depend on the other rows.

Names and definitions are PyTorch's with its default settings (`torch.nn`), in 32 bits.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Float32Array = NDArray[np.float32]
Activation = Callable[[Float32Array], Float32Array]
"""Returns the activated values, shape kept; may write into its argument."""


def relu(x: Float32Array) -> Float32Array:
    """Return max(x, 0)."""
    return np.maximum(x, 0.0, out=x)


def tanh(x: Float32Array) -> Float32Array:
    """Return the hyperbolic tangent."""
    return np.tanh(x, out=x)


def elu(x: Float32Array) -> Float32Array:
    """Return x where it is positive, exp(x) - 1 elsewhere (Clevert et al., 2016)."""
    result: Float32Array = np.where(x > 0, x, np.expm1(np.minimum(x, np.float32(0))))
    return result


def selu(x: Float32Array) -> Float32Array:
    """Return the scaled ELU with the constants of Klambauer et al., 2017."""
    scale, alpha = np.float32(1.0507009873554805), np.float32(1.6732632423543772)
    result: Float32Array = scale * np.where(x > 0, x, alpha * np.expm1(np.minimum(x, np.float32(0))))
    return result


def leaky_relu(x: Float32Array) -> Float32Array:
    """Return x where it is positive, 0.01 x elsewhere."""
    result: Float32Array = np.maximum(x, np.float32(0.01) * x)
    return result


def sigmoid(x: Float32Array) -> Float32Array:
    """Return 1 / (1 + exp(-x))."""
    from scipy.special import expit

    result: Float32Array = expit(x)
    return result


def silu(x: Float32Array) -> Float32Array:
    """Return x sigmoid(x), also called swish."""
    return x * sigmoid(x)


def gelu(x: Float32Array) -> Float32Array:
    """Return x times the standard normal distribution function of x (the exact form, with erf)."""
    from scipy.special import erf

    result: Float32Array = np.float32(0.5) * x * (1 + erf(x * np.float32(np.sqrt(0.5))))
    return result


def softplus(x: Float32Array) -> Float32Array:
    """Return log(1 + exp(x))."""
    return np.logaddexp(x, np.float32(0))


def mish(x: Float32Array) -> Float32Array:
    """Return x tanh(softplus(x))."""
    return x * np.tanh(softplus(x))


ACTIVATIONS: dict[str, Activation] = {
    each.__name__: each for each in (relu, tanh, elu, selu, leaky_relu, sigmoid, silu, gelu, softplus, mish)
}
"""By the name that policy files use."""
