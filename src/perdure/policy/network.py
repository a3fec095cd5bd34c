"""Forward pass of a multilayer perceptron in NumPy, with every row's result independent of the other rows.

A matrix product may add its terms in another order when the number of rows changes, and in another order for some rows
of one product than for others: over 100,000 chaotic steps a difference in the last bit becomes another trajectory. So
rows are packed into tiles of a fixed size, the last one filled up with zeros, and multiplied on one thread. Each
layer's tile is the largest for which this machine's matrix product gives a row the same result wherever in the tile it
lies.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from perdure.policy.activations import ACTIVATIONS
from perdure.policy.errors import PolicyError
from perdure.policy.one_thread import one_thread

TILES = (16, 8, 4, 2, 1)
"""Rows of one product, to choose from; each divides the ones before it. Large tiles run at a better rate, but waste
more on the last few lanes, and not all of them treat every row alike."""
LARGEST_PROBE = 10.0
"""No random row holds a larger number, nor does the hyperbolic tangent."""
PROBES = 4
"""Random rows that a tile is tried with."""

LARGEST_INPUT = 1e6
"""Inputs whose size is at most this never make a network overflow."""

Float32Array = NDArray[np.float32]
Weights = Mapping[str, NDArray[np.floating[Any]]]
"""By name. Stored in 16 or 32 bits; products are of 32 bits."""


class Perceptron:
    """One network, ready to be applied."""

    def __init__(self, weights: Weights, name: str, activation: str) -> None:
        """Build the network from ``{name}.{layer}.weight`` (in, out) and ``{name}.{layer}.bias`` (out,).

        Args:
            weights: All of a policy's weights.
            name: "policy" or "value".
            activation: One of ``ACTIVATIONS``, between layers.

        Raises:
            PolicyError: If layers are missing or do not fit, or there is no such activation.
        """
        count = sum(key.startswith(f"{name}.") for key in weights) // 2
        try:
            layers = [(weights[f"{name}.{i}.weight"], weights[f"{name}.{i}.bias"]) for i in range(count)]
        except KeyError as missing:
            raise PolicyError(f"the {name} network has no weights {missing}") from None
        self._layers = [(np.asarray(weight, np.float32), np.asarray(bias, np.float32)) for weight, bias in layers]
        if activation not in ACTIVATIONS:
            raise PolicyError(f"activation must be one of {', '.join(ACTIVATIONS)}, got {activation!r}")
        self._activate, self._bounded = ACTIVATIONS[activation], activation in ("tanh", "sigmoid")
        self._check(name)
        with one_thread():
            self._tiles = [_largest_fair_tile(weight) for weight, _ in self._layers]

    def _check(self, name: str) -> None:
        if not self._layers:
            raise PolicyError(f"there are no weights of a {name} network")
        given: int | None = None
        for layer, (weight, bias) in enumerate(self._layers):
            fits = weight.ndim == 2 and bias.shape == weight.shape[1:] and given in (None, weight.shape[0])
            if not fits:
                raise PolicyError(
                    f"layer {layer} of the {name} network has weights of shape {weight.shape} and biases of shape "
                    f"{bias.shape}, which fit neither each other nor the layer before"
                )
            given = weight.shape[1]
        if not all(size for weight, _ in self._layers for size in weight.shape):
            raise PolicyError(f"the {name} network has a layer without a neuron")
        if not self._largest_output() < float(np.finfo(np.float32).max):
            raise PolicyError(
                f"the {name} network has weights that are not finite, or so large that a sum could overflow"
            )

    def _largest_output(self) -> float:
        """Return a bound on the size of every sum in the network, over all inputs up to LARGEST_INPUT.

        It is infinite or nan if a weight is.
        """
        bound = largest = LARGEST_INPUT
        for weight, bias in self._layers:
            sums = bound * np.abs(weight).sum(axis=0, dtype=np.float64) + np.abs(bias, dtype=np.float64)
            bound = float(sums.max())
            largest = float(np.maximum(largest, bound))
            # No other activation of `ACTIVATIONS` exceeds 2 |x| + 2.
            bound = LARGEST_PROBE if self._bounded else 2.0 * bound + 2.0
        return largest

    @property
    def input_size(self) -> int:
        """Length of one input."""
        return int(self._layers[0][0].shape[0])

    @property
    def output_size(self) -> int:
        """Length of one output."""
        return int(self._layers[-1][1].shape[0])

    def __call__(self, inputs: Float32Array) -> Float32Array:
        """Return outputs, shape (n, outputs), of inputs of shape (n, input_size)."""
        rows = len(inputs)
        hidden = np.zeros((-(-rows // TILES[0]) * TILES[0], self.input_size), np.float32)
        hidden[:rows] = inputs
        with one_thread():
            hidden = self._pass(hidden)
        return hidden.reshape(-1, hidden.shape[-1])[:rows]

    def _pass(self, hidden: Float32Array) -> Float32Array:
        for layer, ((weight, bias), tile) in enumerate(zip(self._layers, self._tiles, strict=True)):
            hidden = hidden.reshape(-1, tile, len(weight)) @ weight
            hidden += bias
            if layer < len(self._layers) - 1:
                hidden = self._activate(hidden)
        return hidden


def _largest_fair_tile(weight: Float32Array) -> int:
    return next(tile for tile in TILES if _treats_rows_alike(tile, weight))


def _treats_rows_alike(tile: int, weight: Float32Array) -> bool:
    """Return whether a row's product with these weights is the same, bit for bit, at every place in the tile."""
    rows = np.random.default_rng(0).standard_normal((PROBES, 1, len(weight)), np.float32)
    product = np.repeat(rows, tile, axis=1) @ weight
    return bool((product == product[:, :1]).all())
