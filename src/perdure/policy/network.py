"""Forward pass of a multilayer perceptron in NumPy, with every row's result independent of the other rows."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from perdure.policy.activations import ACTIVATIONS
from perdure.policy.errors import PolicyError
from perdure.policy.fair_product import FairProduct, Float32Array, pad
from perdure.policy.film import Film
from perdure.policy.one_thread import one_thread

LARGEST_PROBE = 10.0
"""No bounded activation exceeds it."""

LARGEST_INPUT = 1e6
"""Inputs whose size is at most this never make a network overflow."""

Weights = Mapping[str, NDArray[np.floating[Any]]]
"""By name. Stored in 16 or 32 bits; products are of 32 bits."""


class Perceptron:
    """One network, ready to be applied."""

    def __init__(self, weights: Weights, name: str, activation: str) -> None:
        """Build the network from ``{name}.{layer}.weight`` (in, out) and ``{name}.{layer}.bias`` (out,).

        Hidden layers that phi modulates also have ``{name}.{layer}.scale`` and ``{name}.{layer}.shift``, both
        (embedding_size, out); the last numbers of an input are then phi, see `Film`.

        Args:
            weights: All of a policy's weights.
            name: "policy" or "value".
            activation: One of ``ACTIVATIONS``, between layers.

        Raises:
            PolicyError: If layers are missing or do not fit, or there is no such activation.
        """
        if activation not in ACTIVATIONS:
            raise PolicyError(f"activation must be one of {', '.join(ACTIVATIONS)}, got {activation!r}")
        self._activate, self._bounded = ACTIVATIONS[activation], activation in ("tanh", "sigmoid")
        names = {key for key in weights if key.startswith(f"{name}.")}
        hidden = sum(key.endswith(".weight") for key in names) - 1
        modulated = hidden if any(key.endswith((".scale", ".shift")) for key in names) else 0
        self._layers = _pairs(weights, name, ("weight", "bias"), hidden + 1)
        pairs = _pairs(weights, name, ("scale", "shift"), modulated)
        if len(names) != 2 * (len(self._layers) + len(pairs)):
            raise PolicyError(f"the {name} network has weights that belong to no layer: {', '.join(sorted(names))}")
        _check(self._layers, name)
        self._film = Film.of(pairs, [len(bias) for _, bias in self._layers[:-1]], name) if pairs else None
        if not self._largest_output() < float(np.finfo(np.float32).max):
            raise PolicyError(
                f"the {name} network has weights that are not finite, or so large that a sum could overflow"
            )
        self._products = [FairProduct(weight) for weight, _ in self._layers]

    def _largest_output(self) -> float:
        """Return a bound on the size of every sum in the network, over all inputs up to LARGEST_INPUT.

        It is infinite or nan if a weight is.
        """
        bound = largest = LARGEST_INPUT
        for layer, (weight, bias) in enumerate(self._layers):
            sums = bound * np.abs(weight).sum(axis=0, dtype=np.float64) + np.abs(bias, dtype=np.float64)
            bound = float(sums.max())
            if self._film is not None and layer < len(self._layers) - 1:
                bound = self._film.bound(layer, bound, LARGEST_INPUT)
            largest = float(np.maximum(largest, bound))
            # No other activation of `ACTIVATIONS` exceeds 2 |x| + 2.
            bound = LARGEST_PROBE if self._bounded else 2.0 * bound + 2.0
        return largest

    @property
    def input_size(self) -> int:
        """Length of one input."""
        return len(self._layers[0][0]) + self.modulation_size

    @property
    def modulation_size(self) -> int:
        """Length of the part of an input that modulates hidden layers; 0 without modulation."""
        return 0 if self._film is None else self._film.size

    @property
    def output_size(self) -> int:
        """Length of one output."""
        return int(self._layers[-1][1].shape[0])

    def __call__(self, inputs: Float32Array) -> Float32Array:
        """Return outputs, shape (n, outputs), of inputs of shape (n, input_size)."""
        with one_thread():
            return self._pass(pad(inputs))[: len(inputs)]

    def _pass(self, hidden: Float32Array) -> Float32Array:
        if self._film is not None:
            first = len(self._layers[0][0])
            hidden, phi = (np.ascontiguousarray(part) for part in np.split(hidden, [first], axis=1))
        for layer, (product, (_, bias)) in enumerate(zip(self._products, self._layers, strict=True)):
            hidden = product(hidden)
            hidden += bias
            if layer < len(self._layers) - 1:
                if self._film is not None:
                    hidden = self._film(layer, hidden, phi)
                hidden = self._activate(hidden)
        return hidden


def _pairs(
    weights: Weights, network: str, parts: tuple[str, str], layers: int
) -> list[tuple[Float32Array, Float32Array]]:
    """Return the two arrays of each of the first layers, in 32 bits."""
    pairs = []
    for layer in range(layers):
        names = [f"{network}.{layer}.{part}" for part in parts]
        for name in names:
            if name not in weights:
                raise PolicyError(f"the {network} network has no weights {name!r}")
        first, second = (np.asarray(weights[name], np.float32) for name in names)
        pairs.append((first, second))
    return pairs


def _check(layers: list[tuple[Float32Array, Float32Array]], name: str) -> None:
    if not layers:
        raise PolicyError(f"there are no weights of a {name} network")
    given: int | None = None
    for layer, (weight, bias) in enumerate(layers):
        fits = weight.ndim == 2 and bias.shape == weight.shape[1:] and given in (None, weight.shape[0])
        if not fits:
            raise PolicyError(
                f"layer {layer} of the {name} network has weights of shape {weight.shape} and biases of shape "
                f"{bias.shape}, which fit neither each other nor the layer before"
            )
        given = weight.shape[1]
    if not all(size for weight, _ in layers for size in weight.shape):
        raise PolicyError(f"the {name} network has a layer without a neuron")
