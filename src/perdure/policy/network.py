"""Forward pass of a multilayer perceptron in NumPy, with every row's result independent of the other rows.

A matrix product may add its terms in another order when the number of rows changes, and over 100,000 chaotic steps a
difference in the last bit becomes another trajectory. So rows are packed into tiles of one fixed size, the last one
filled up with zeros, and every product the library sees has the same shape.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

TILE = 24
"""Rows of one product. Small tiles waste less when few lanes are alive, large ones run at a better rate."""

Float32Array = NDArray[np.float32]


class Perceptron:
    """Weights of one network, ready to be applied."""

    def __init__(self, weights: Mapping[str, Float32Array], name: str, activation: str) -> None:
        """Takes ``{name}.{layer}.weight`` (in, out) and ``{name}.{layer}.bias`` (out,) from ``weights``.

        Args:
            weights: All of a policy's weights.
            name: "policy" or "value".
            activation: "relu" or "tanh", between layers.
        """
        count = sum(key.startswith(f"{name}.") for key in weights) // 2
        self._layers = [(weights[f"{name}.{i}.weight"], weights[f"{name}.{i}.bias"]) for i in range(count)]
        self._rectify = activation == "relu"

    @property
    def input_size(self) -> int:
        """Length of one input."""
        return int(self._layers[0][0].shape[0])

    def __call__(self, inputs: Float32Array) -> Float32Array:
        """Outputs, shape (n, outputs), of inputs of shape (n, input_size)."""
        rows = len(inputs)
        tiles = -(-rows // TILE)
        hidden = np.zeros((tiles, TILE, self.input_size), np.float32)
        hidden.reshape(-1, self.input_size)[:rows] = inputs
        for layer, (weight, bias) in enumerate(self._layers):
            hidden = hidden @ weight
            hidden += bias
            if layer < len(self._layers) - 1:
                if self._rectify:
                    np.maximum(hidden, 0.0, out=hidden)
                else:
                    np.tanh(hidden, out=hidden)
        return hidden.reshape(tiles * TILE, -1)[:rows]
