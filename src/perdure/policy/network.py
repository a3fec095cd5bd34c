"""The forward pass of a policy's networks in NumPy, each row's result independent of the other rows, bit for bit.

A matrix product may add its terms in another order when the number of rows or of threads changes, and in another order
for some rows of one product than for others: over 100,000 chaotic steps a difference in the last bit becomes another
trajectory. So `RowInvariantMatmul` multiplies tiles of a fixed number of rows on one thread.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from perdure.errors import PerdureError

Float32Array = NDArray[np.float32]
Weights = Mapping[str, NDArray[np.floating[Any]]]
"""By name. Stored in 16 or 32 bits; products are of 32 bits."""
Activation = Callable[[Any], Any]
"""Returns the activated values, shape kept; may write into its argument."""
LARGEST_INPUT = 1e6
"""Inputs whose size is at most this never make a network overflow."""
LARGEST_PROBE = 10.0
"""No bounded activation exceeds it."""
TILES = (16, 8, 4, 2, 1)
"""Rows of one product, to choose from; each divides the ones before it. Large tiles run at a better rate, but waste
more on the last few lanes, and not all of them treat every row alike."""
PROBES = 4
"""Random rows that a tile is tried with."""


class Perceptron:
    """One network, of weights ``{name}.{layer}.weight`` (in, out) and ``{name}.{layer}.bias`` (out,).

    Hidden layers that phi modulates also have ``{name}.{layer}.scale`` and ``{name}.{layer}.shift``, both
    (embedding_size, out); the last numbers of an input are then phi, see `FiLM`.

    Raises:
        PerdureError: If layers are missing or do not fit, or there is no such activation.
    """

    def __init__(self, weights: Weights, name: str, activation: str) -> None:
        if activation not in ACTIVATIONS:
            raise PerdureError(f"activation must be one of {', '.join(ACTIVATIONS)}, got {activation!r}")
        self._activate = ACTIVATIONS[activation]
        self._bounded = activation in ("tanh", "sigmoid")
        names = {key for key in weights if key.startswith(f"{name}.")}
        hidden = sum(key.endswith(".weight") for key in names) - 1
        self._layers = _pairs(weights, name, ("weight", "bias"), hidden + 1)
        pairs = []
        if any(key.endswith((".scale", ".shift")) for key in names):
            pairs = _pairs(weights, name, ("scale", "shift"), hidden)
        if len(names) != 2 * (len(self._layers) + len(pairs)):
            raise PerdureError(f"the {name} network has weights that belong to no layer: {', '.join(sorted(names))}")
        _check(self._layers, name)
        self._film: FiLM | None = None
        if pairs:
            self._film = FiLM.of(pairs, [len(bias) for _, bias in self._layers[:-1]], name)
        if not self._largest_output() < float(np.finfo(np.float32).max):
            raise PerdureError(
                f"the {name} network has weights that are not finite, or so large that a sum could overflow"
            )
        self._products = [RowInvariantMatmul(weight) for weight, _ in self._layers]
        self.modulation_size = 0
        """Length of the part of an input that modulates hidden layers; 0 without modulation."""
        if self._film is not None:
            self.modulation_size = len(self._film.scales[0].matrix)
        self.input_size = len(self._layers[0][0]) + self.modulation_size
        """Length of one input."""
        self.output_size = len(self._layers[-1][1])
        """Length of one output."""

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
            if self._bounded:
                bound = LARGEST_PROBE
            else:  # no other activation of `ACTIVATIONS` exceeds 2 |x| + 2
                bound = 2.0 * bound + 2.0
        return largest

    def __call__(self, inputs: Any) -> Any:
        """Return outputs, shape (n, outputs), of inputs (n, input_size): arrays, or values of an ONNX graph."""
        if not isinstance(inputs, np.ndarray):
            return self._pass(inputs)
        with one_thread():
            return self._pass(pad(inputs))[: len(inputs)]

    def _pass(self, inputs: Any) -> Any:
        hidden = inputs
        if self._film is not None:
            first = len(self._layers[0][0])
            hidden = inputs[:, :first]
            phi = inputs[:, first:]
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
                raise PerdureError(f"the {network} network has no weights {name!r}")
        first, second = (np.asarray(weights[name], np.float32) for name in names)
        pairs.append((first, second))
    return pairs


def _check(layers: list[tuple[Float32Array, Float32Array]], name: str) -> None:
    if not layers:
        raise PerdureError(f"there are no weights of a {name} network")
    given: int | None = None
    for layer, (weight, bias) in enumerate(layers):
        if 0 in weight.shape:
            raise PerdureError(f"the {name} network has a layer without a neuron")
        fits = weight.ndim == 2 and bias.shape == weight.shape[1:] and given in (None, weight.shape[0])
        if not fits:
            raise PerdureError(
                f"layer {layer} of the {name} network has weights of shape {weight.shape} and biases of shape "
                f"{bias.shape}, which fit neither each other nor the layer before"
            )
        given = weight.shape[1]


@dataclass(frozen=True, eq=False)
class FiLM:
    """Feature-wise linear modulation: phi scales and shifts every hidden layer (Perez et al., 2018).

    The alternative to appending phi to the observation; `perdure.learn.networks` has the equation.
    """

    scales: Sequence[RowInvariantMatmul]
    shifts: Sequence[RowInvariantMatmul]

    @classmethod
    def of(cls, pairs: Sequence[tuple[Float32Array, Float32Array]], widths: Sequence[int], name: str) -> FiLM:
        """Return the modulation by a pair (scale, shift) for each hidden layer, of shape (embedding_size, width).

        Raises:
            PerdureError: If shapes do not fit.
        """
        first_scale = pairs[0][0]
        size = 0
        if first_scale.ndim == 2:
            size = len(first_scale)
        for layer, (pair, width) in enumerate(zip(pairs, widths, strict=True)):
            for part, matrix in zip(("scale", "shift"), pair, strict=True):
                if not size or matrix.shape != (size, width):
                    raise PerdureError(
                        f"the {part} of layer {layer} of the {name} network has the shape {matrix.shape}; it must have "
                        f"one row for each number of phi and {width} columns"
                    )
        return cls([RowInvariantMatmul(scale) for scale, _ in pairs], [RowInvariantMatmul(shift) for _, shift in pairs])

    def __call__(self, layer: int, sums: Any, phi: Any) -> Any:
        """Return (1 + phi @ scale) * sums + phi @ shift, shape (n, width); n is a multiple of the largest tile."""
        factors = self.scales[layer](phi)
        factors += 1.0
        factors *= sums
        factors += self.shifts[layer](phi)
        return factors

    def bound(self, layer: int, sums: float, largest_phi: float) -> float:
        """Return a bound on the size of the result and of everything on the way to it."""
        factor = 1.0 + largest_phi * _column_sum(self.scales[layer])
        return factor * max(sums, 1.0) + largest_phi * _column_sum(self.shifts[layer])


def _column_sum(product: RowInvariantMatmul) -> float:
    return float(np.abs(product.matrix).sum(axis=0, dtype=np.float64).max())


class RowInvariantMatmul:
    """Rows times one matrix, shape (in, out). Use it under `one_thread`.

    The tile is the largest for which this machine's product gives a row the same result wherever in the tile it lies.
    """

    def __init__(self, matrix: Float32Array) -> None:
        self.matrix = matrix

    @cached_property
    def _tile(self) -> int:
        return next(tile for tile in TILES if _treats_rows_alike(tile, self.matrix))

    def __call__(self, rows: Any) -> Any:
        """Return rows @ matrix, shape (n, out), of rows (n, in); n must be a multiple of the largest tile."""
        if not isinstance(rows, np.ndarray):  # a value in an ONNX graph
            return rows @ self.matrix
        product = np.ascontiguousarray(rows).reshape(-1, self._tile, len(self.matrix)) @ self.matrix
        return product.reshape(len(rows), -1)


def _treats_rows_alike(tile: int, matrix: Float32Array) -> bool:
    """Return whether a row's product with this matrix is the same, bit for bit, at every place in the tile."""
    rows = np.random.default_rng(0).standard_normal((PROBES, 1, len(matrix)), np.float32)
    product = np.repeat(rows, tile, axis=1) @ matrix
    return bool((product == product[:, :1]).all())


def pad(rows: Float32Array) -> Float32Array:
    """Return the rows with rows of zeros after them, up to a multiple of the largest tile."""
    padded = np.zeros((-(-len(rows) // TILES[0]) * TILES[0], rows.shape[1]), np.float32)
    padded[: len(rows)] = rows
    return padded


_inside = False


@contextmanager
def one_thread() -> Iterator[None]:
    """Run NumPy's matrix products on one thread for the duration of a block.

    Entering the block costs tens of microseconds, so put whole loops inside it.
    """
    global _inside
    if _inside:
        yield
        return
    changed = []
    for library in _libraries():
        number = library.get_num_threads()
        if number != 1:
            changed.append((library, number))
            library.set_num_threads(1)
    _inside = True
    try:
        yield
    finally:
        _inside = False
        for library, number in changed:
            library.set_num_threads(number)


@cache
def _libraries() -> list[Any]:
    """Return the matrix libraries of this process; searched once, because the search takes milliseconds."""
    from threadpoolctl import ThreadpoolController

    controllers: list[Any] = ThreadpoolController().select(user_api="blas").lib_controllers
    return controllers


def _elu(x: Any, alpha: float = 1.0) -> Any:
    return np.maximum(x, np.float32(0)) + alpha * np.expm1(np.minimum(x, np.float32(0)))


def _sigmoid(x: Any) -> Any:
    from scipy.special import expit

    return expit(x)


def _gelu(x: Any) -> Any:
    """Return x times the standard normal distribution function of x (the exact form, with erf)."""
    from scipy.special import erf

    return np.float32(0.5) * x * (1 + erf(x * np.float32(np.sqrt(0.5))))


def _softplus(x: Any) -> Any:
    return np.logaddexp(x, np.float32(0))


ACTIVATIONS: dict[str, Activation] = {
    "relu": lambda x: np.maximum(x, 0.0, out=x),
    "tanh": lambda x: np.tanh(x, out=x),
    "elu": _elu,
    "selu": lambda x: 1.0507009873554805 * _elu(x, 1.6732632423543772),
    "leaky_relu": lambda x: np.maximum(x, np.float32(0.01) * x),
    "sigmoid": _sigmoid,
    "silu": lambda x: x * _sigmoid(x),
    "gelu": _gelu,
    "softplus": _softplus,
    "mish": lambda x: x * np.tanh(_softplus(x)),
}
"""By the name that policy files use: PyTorch's functions with its default settings (`torch.nn`), in 32 bits. All are
made of ufuncs, which `perdure.policy.onnx` knows."""
