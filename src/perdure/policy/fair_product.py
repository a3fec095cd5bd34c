"""Matrix product in which every row's result is independent of the other rows.

A matrix product may add its terms in another order when the number of rows changes, and in another order for some rows
of one product than for others: over 100,000 chaotic steps a difference in the last bit becomes another trajectory. So
rows are packed into tiles of a fixed size and multiplied on one thread. The tile of a matrix is the largest for which
this machine's product gives a row the same result wherever in the tile it lies.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

TILES = (16, 8, 4, 2, 1)
"""Rows of one product, to choose from; each divides the ones before it. Large tiles run at a better rate, but waste
more on the last few lanes, and not all of them treat every row alike."""
PROBES = 4
"""Random rows that a tile is tried with."""

Float32Array = NDArray[np.float32]


class FairProduct:
    """Rows times one matrix. Use it under `one_thread`."""

    def __init__(self, matrix: Float32Array) -> None:
        """Keep a matrix of shape (in, out); the tile is chosen at the first product."""
        self.matrix = matrix

    @cached_property
    def _tile(self) -> int:
        return next(tile for tile in TILES if _treats_rows_alike(tile, self.matrix))

    def __call__(self, rows: Float32Array) -> Float32Array:
        """Return rows @ matrix, shape (n, out), of rows (n, in); n must be a multiple of the largest tile."""
        product: Float32Array = rows.reshape(-1, self._tile, len(self.matrix)) @ self.matrix
        return product.reshape(len(rows), -1)


def pad(rows: Float32Array) -> Float32Array:
    """Return the rows with rows of zeros after them, up to a multiple of the largest tile."""
    padded = np.zeros((-(-len(rows) // TILES[0]) * TILES[0], rows.shape[1]), np.float32)
    padded[: len(rows)] = rows
    return padded


def _treats_rows_alike(tile: int, matrix: Float32Array) -> bool:
    """Return whether a row's product with this matrix is the same, bit for bit, at every place in the tile."""
    rows = np.random.default_rng(0).standard_normal((PROBES, 1, len(matrix)), np.float32)
    product = np.repeat(rows, tile, axis=1) @ matrix
    return bool((product == product[:, :1]).all())
