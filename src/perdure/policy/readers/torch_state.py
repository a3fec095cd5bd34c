"""Read a PyTorch state dict without PyTorch and without running its pickle.

`torch.save` (since version 1.6) writes a zip archive: a pickle that describes the tensors, and one member with the raw
numbers of each storage.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from perdure.policy.errors import PolicyFileError
from perdure.policy.readers.inert_pickle import PERSISTENT, Call, read_pickle
from perdure.policy.readers.numpy_arrays import MAX_DIMENSIONS
from perdure.policy.readers.zip_members import ZipMembers

MAX_DESCRIPTION = 8_000_000
"""Bytes of the pickle; the description of a tensor takes about 150."""
MAX_STORAGE = 256_000_000
"""Bytes of one storage: 64 million weights."""
_REBUILD = "torch._utils._rebuild_tensor_v2"
_STORAGES = {"torch.HalfStorage": "<f2", "torch.FloatStorage": "<f4", "torch.DoubleStorage": "<f8"}
_OTHER_STORAGES = {f"torch.{kind}Storage" for kind in ("BFloat16", "Bool", "Byte", "Char", "Short", "Int", "Long")}
ALLOWED = {"collections.OrderedDict", "torch.Size", _REBUILD, *_STORAGES, *_OTHER_STORAGES}
"""Names that the pickle of a state dict may refer to."""


class TorchState:
    """The tensors of a state dict, by name; the numbers of a tensor are read when it is asked for."""

    def __init__(self, data: bytes, what: str) -> None:
        """Read the description of the tensors.

        Args:
            data: What `torch.save(module.state_dict(), ...)` wrote.
            what: Which file it is, for messages.

        Raises:
            PolicyFileError: If it is damaged, asks for functions that a state dict does not need, or is too large.
        """
        self._what = what
        if data[:2] != b"PK":
            raise PolicyFileError(
                f"{what} is not a zip archive; PyTorch before 1.6 wrote other files: give --trust if you trust the file"
            )
        self._members = ZipMembers(data, what)
        descriptions = [name for name in self._members.names if name.count("/") == 1 and name.endswith("/data.pkl")]
        if len(descriptions) != 1:
            raise PolicyFileError(f"{what} does not hold exactly one state dict of PyTorch")
        self._folder = descriptions[0].removesuffix("data.pkl")
        if f"{self._folder}byteorder" in self._members.names and self._read("byteorder", 100) != b"little":
            raise PolicyFileError(f"{what} was written on a big-endian machine, which is not read")
        state = read_pickle(self._read("data.pkl", MAX_DESCRIPTION), ALLOWED, what)
        if not (isinstance(state, Call) and state.function == "collections.OrderedDict" and not state.arguments):
            raise PolicyFileError(f"{what} is not a state dict of PyTorch")
        self._tensors = {str(name): tensor for name, tensor in state.items.items()}

    @property
    def names(self) -> list[str]:
        """Names of all entries, such as "actor.mu.weight"."""
        return list(self._tensors)

    def array(self, name: str) -> NDArray[np.float32]:
        """Return a tensor as a new array.

        Raises:
            PolicyFileError: If there is no such tensor, it is damaged, or not all of its numbers are finite.
        """
        try:
            array = self._build(self._tensors[name])
        except PolicyFileError:
            raise
        except (KeyError, TypeError, ValueError, AttributeError):
            raise PolicyFileError(f"{self._what}: {name!r} is not a tensor of floating-point numbers") from None
        with np.errstate(over="ignore"):
            result = np.array(array, np.float32, order="C")
        if not np.isfinite(result).all():
            raise PolicyFileError(f"{self._what}: the weights {name!r} hold numbers that are not finite")
        return result

    def _build(self, tensor: Any) -> NDArray[Any]:
        if tensor.function != _REBUILD:
            raise TypeError
        storage, offset, shape, strides = tensor.arguments[:4]
        numbers = self._storage(storage)
        if len(shape) > MAX_DIMENSIONS:
            raise ValueError
        whole = [offset, *shape, *strides]
        if not all(type(each) is int and 0 <= each <= MAX_STORAGE for each in whole) or len(shape) != len(strides):
            raise ValueError
        last = offset + sum((length - 1) * stride for length, stride in zip(shape, strides, strict=True))
        if not math.prod(shape) or math.prod(shape) > len(numbers) or last >= len(numbers):
            raise ValueError
        byte_strides = [stride * numbers.itemsize for stride in strides]
        return np.lib.stride_tricks.as_strided(numbers[offset:], shape, byte_strides, writeable=False)

    def _storage(self, storage: Any) -> NDArray[Any]:
        (reference,) = storage.arguments
        kind, of, key = reference[:3]
        if storage.function != PERSISTENT or kind != "storage" or not isinstance(key, str):
            raise TypeError
        return np.frombuffer(self._read(f"data/{key}", MAX_STORAGE), _STORAGES[of.path])

    def _read(self, name: str, limit: int) -> bytes:
        return self._members.read(f"{self._folder}{name}", limit)
