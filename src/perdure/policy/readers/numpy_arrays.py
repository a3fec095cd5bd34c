"""Extract NumPy arrays from a pickle that was read as data (`inert_pickle.py`)."""

from __future__ import annotations

import math
import re
from typing import Any

import numpy as np
from numpy.typing import NDArray

from perdure.policy.errors import PolicyFileError
from perdure.policy.readers.inert_pickle import Call

_CORES = ("numpy.core", "numpy._core")
"""Modules of NumPy's functions in NumPy 1 and NumPy 2."""
RECONSTRUCT = {f"{core}.multiarray._reconstruct" for core in _CORES}
SCALAR = {f"{core}.multiarray.scalar" for core in _CORES}
FROM_BUFFER = {f"{core}.numeric._frombuffer" for core in _CORES}
MAX_DIMENSIONS = 32
"""NumPy's own limit was 32 for most of its life."""
NUMPY_NAMES = frozenset({"numpy.dtype", "numpy.ndarray", "_codecs.encode", *RECONSTRUCT, *SCALAR, *FROM_BUFFER})
"""Names that a pickle of arrays may refer to."""


def read_numbers(node: Any, what: str) -> NDArray[np.float64]:
    """Return the numbers of an array, a NumPy scalar or a Python number, as float64.

    Args:
        node: As `read_pickle` returns it.
        what: What the numbers are, for messages.

    Raises:
        PolicyFileError: If these are no real numbers, or data and shape do not fit.
    """
    try:
        return np.asarray(float(node)) if isinstance(node, int | float) else _array(node).astype(np.float64)
    except (TypeError, ValueError, AttributeError, OverflowError, LookupError):
        raise PolicyFileError(f"{what} is not an array of real numbers") from None


def _array(node: Any) -> NDArray[Any]:
    if node.function in RECONSTRUCT:
        _, shape, kind, fortran, data = node.state
        return _filled(data, shape, kind, "F" if fortran else "C")
    if node.function in FROM_BUFFER:
        data, kind, shape, order = node.arguments
        return _filled(data, shape, kind, order)
    if node.function in SCALAR:
        kind, data = node.arguments
        return _filled(data, (), kind, "C")
    raise TypeError


def _filled(data: Any, shape: Any, kind: Any, order: Any) -> NDArray[Any]:
    if isinstance(data, Call) and data.function == "_codecs.encode":  # bytes, as old pickle protocols write them
        data = data.arguments[0].encode("latin-1")
    dtype = _dtype(kind)
    # Before their product, which takes minutes if a file names a million of them.
    if len(shape) > MAX_DIMENSIONS or not all(type(length) is int and length >= 0 for length in shape):
        raise TypeError
    if math.prod(shape) * dtype.itemsize != len(data) or order not in ("C", "F"):
        raise ValueError
    return np.frombuffer(bytes(data), dtype).reshape(shape, order=order)


def _dtype(node: Any) -> np.dtype[Any]:
    name = node.arguments[0]
    if node.function != "numpy.dtype" or not re.fullmatch(r"[fiu][1248]|b1", name):
        raise TypeError
    byte_order = "<" if node.state is None else node.state[1]
    dtype: np.dtype[Any] = np.dtype(name).newbyteorder(byte_order if byte_order in ("<", ">") else "=")
    return dtype
