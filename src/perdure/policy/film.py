"""Feature-wise linear modulation: the time-to-go scales and shifts the hidden layers (Perez et al., 2018).

The alternative to appending phi to the observation; `perdure.ppo.networks` has the equation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from perdure.policy.errors import PolicyError
from perdure.policy.fair_product import FairProduct, Float32Array


@dataclass(frozen=True, eq=False)
class Film:
    """Scales and shifts of every hidden layer."""

    scales: Sequence[FairProduct]
    shifts: Sequence[FairProduct]

    @classmethod
    def of(cls, pairs: Sequence[tuple[Float32Array, Float32Array]], widths: Sequence[int], name: str) -> Film:
        """Return the modulation by these (scale, shift), each of shape (embedding_size, width).

        Args:
            pairs: One for each hidden layer; at least one.
            widths: Of the hidden layers.
            name: Of the network, for messages.

        Raises:
            PolicyError: If shapes do not fit.
        """
        size = len(pairs[0][0]) if pairs[0][0].ndim == 2 else 0
        for layer, (pair, width) in enumerate(zip(pairs, widths, strict=True)):
            for part, matrix in zip(("scale", "shift"), pair, strict=True):
                if not size or matrix.shape != (size, width):
                    raise PolicyError(
                        f"the {part} of layer {layer} of the {name} network has the shape {matrix.shape}; it must have "
                        f"one row for each number of phi and {width} columns"
                    )
        return cls([FairProduct(scale) for scale, _ in pairs], [FairProduct(shift) for _, shift in pairs])

    @property
    def size(self) -> int:
        """Length of phi."""
        return len(self.scales[0].matrix)

    def __call__(self, layer: int, sums: Float32Array, phi: Float32Array) -> Float32Array:
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


def _column_sum(product: FairProduct) -> float:
    return float(np.abs(product.matrix).sum(axis=0, dtype=np.float64).max())
