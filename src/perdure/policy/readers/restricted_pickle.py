"""Read a pickle as data, with its arrays and PyTorch tensors: nothing is imported, nothing of the file is called.

A pickle is a program for a stack machine. Where it asks for a function or a class by name, the name must be on the
caller's list and stands for a subclass of `Stub`, which keeps what it is called with. The reader is the one written in
Python: the one in C reserves as much memory as a pickle of ten bytes names (`LONG_BINPUT`).
"""

from __future__ import annotations

import io
import lzma
import math
import pickle
import re
import zipfile
import zlib
from collections.abc import Collection
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from perdure.errors import MANUAL, PerdureError

PERSISTENT = "persistent id"
"""Function name of a `Stub` that stands for an object kept outside the pickle."""
_INSTRUCTIONS = """
    PROTO FRAME STOP MARK NONE NEWTRUE NEWFALSE BININT BININT1 BININT2 LONG1 BINFLOAT BINUNICODE SHORT_BINUNICODE
    BINBYTES SHORT_BINBYTES BINBYTES8 EMPTY_TUPLE TUPLE TUPLE1 TUPLE2 TUPLE3 EMPTY_LIST APPEND APPENDS EMPTY_DICT
    SETITEM SETITEMS GLOBAL STACK_GLOBAL REDUCE NEWOBJ BUILD BINPERSID BINPUT LONG_BINPUT MEMOIZE BINGET LONG_BINGET
"""
"""What is read; others, such as BYTEARRAY8, reserve memory before they look for the bytes."""


class Stub:
    """An object of the pickle, which was not made. A subclass stands for its class or the function that makes it."""

    function = ""
    """Full name of the function or class, such as "numpy.dtype"."""
    arguments: tuple[Any, ...]
    state: Any
    """What the object would be filled with (`__setstate__`)."""
    items: dict[Any, Any]
    """Entries, if the object is a mapping."""

    def __new__(cls, *arguments: Any) -> Stub:
        """Keep the arguments of the call."""
        stub = super().__new__(cls)
        stub.arguments = arguments
        stub.state = None
        stub.items = {}
        return stub


def read_pickle(data: bytes, allowed: Collection[str], what: str) -> Any:
    """Return what a pickle describes, with every object that is no plain value left as a `Stub`.

    Args:
        data: The pickle.
        allowed: Full names of the functions and classes that may occur.
        what: Which file it is, for messages.

    Raises:
        PerdureError: If it is damaged, or asks for a function or class that is not allowed.
    """
    try:
        return _Reader(data, allowed, what).load()
    except PerdureError:
        raise
    except Exception as error:  # the reader does not say what it raises
        raise PerdureError(f"{what} is damaged, or not a pickle: {type(error).__name__}") from None


_Unpickler: Any = pickle._Unpickler


class _Reader(_Unpickler):  # type: ignore[misc]
    dispatch: ClassVar[dict[int, Any]] = {
        code: _Unpickler.dispatch[code] for code in (getattr(pickle, name)[0] for name in _INSTRUCTIONS.split())
    }

    def __init__(self, data: bytes, allowed: Collection[str], what: str) -> None:
        super().__init__(io.BytesIO(data))
        self._allowed = allowed
        self._what = what
        self._stubs: dict[str, type[Stub]] = {}

    def find_class(self, module: str, name: str) -> type[Stub]:
        path = f"{module}.{name}"
        if path not in self._allowed:
            raise PerdureError(
                f"{self._what} asks for the Python object {path[:100]!r}, which was not run; if it is a model of "
                "Stable-Baselines3 that you trust, give --trust (trust=True in Python)"
            )
        return self._stub(path)

    def persistent_load(self, pid: Any) -> Stub:
        return self._stub(PERSISTENT)(pid)

    def _stub(self, path: str) -> type[Stub]:
        return self._stubs.setdefault(path, type("_Stub", (Stub,), {"function": path}))

    def load_build(self) -> None:
        state = self.stack.pop()
        if not isinstance(self.stack[-1], Stub):
            raise TypeError
        self.stack[-1].state = state

    def load_setitem(self) -> None:
        value = self.stack.pop()
        key = self.stack.pop()
        self._update([key, value])

    def load_setitems(self) -> None:
        self._update(self.pop_mark())

    def _update(self, pairs: list[Any]) -> None:
        target = self.stack[-1]
        entries = target.items if isinstance(target, Stub) else target
        # Nested tuples as keys could take for ever to hash.
        if not isinstance(entries, dict) or not all(isinstance(key, str | int | float | None) for key in pairs[::2]):
            raise TypeError
        entries.update(zip(pairs[::2], pairs[1::2], strict=True))

    dispatch |= {pickle.BUILD[0]: load_build, pickle.SETITEM[0]: load_setitem, pickle.SETITEMS[0]: load_setitems}


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
    """Return the numbers of an array, a NumPy scalar or a Python number from `read_pickle`, as float64.

    Raises:
        PerdureError: If these are no real numbers, or data and shape do not fit.
    """
    try:
        if isinstance(node, int | float):
            return np.asarray(float(node))
        return _array(node).astype(np.float64)
    except (TypeError, ValueError, AttributeError, OverflowError, LookupError):
        raise PerdureError(f"{what} is not an array of real numbers") from None


def _array(node: Any) -> NDArray[Any]:
    data, kind, shape, order = _described_array(node)
    if isinstance(data, Stub) and data.function == "_codecs.encode":  # bytes, as old pickle protocols write them
        data = data.arguments[0].encode("latin-1")
    dtype = _number_type(kind)
    # Before their product, which takes minutes if a file names a million of them.
    if len(shape) > MAX_DIMENSIONS or not all(type(length) is int and length >= 0 for length in shape):
        raise TypeError
    if math.prod(shape) * dtype.itemsize != len(data):
        raise ValueError
    numbers: NDArray[Any] = np.frombuffer(bytes(data), dtype)
    if order == "C":
        return numbers.reshape(tuple(shape))
    if order == "F":
        return numbers.reshape(tuple(shape), order="F")
    raise ValueError


def _described_array(node: Any) -> tuple[Any, Any, Any, Any]:
    """Return data, number type, shape and order of an array or scalar; TypeError if the object is neither."""
    if node.function in RECONSTRUCT:
        _, shape, kind, fortran, data = node.state
        return data, kind, shape, "F" if fortran else "C"
    if node.function in FROM_BUFFER:
        data, kind, shape, order = node.arguments
        return data, kind, shape, order
    if node.function in SCALAR:
        kind, data = node.arguments
        return data, kind, (), "C"
    raise TypeError


def _number_type(kind: Any) -> np.dtype[Any]:
    name = kind.arguments[0]
    if kind.function != "numpy.dtype" or not re.fullmatch(r"[fiu][1248]|b1", name):
        raise TypeError
    byte_order = "<"
    if kind.state is not None:
        byte_order = kind.state[1]
    if byte_order not in ("<", ">"):
        byte_order = "="
    dtype: np.dtype[Any] = np.dtype(name).newbyteorder(byte_order)
    return dtype


MAX_MEMBERS = 10_000
"""A large network has a few hundred."""
_ENTRY = b"PK\x01\x02"
"""Begins each line of an archive's table of contents."""


class ZipMembers:
    """An untrusted zip archive in memory, its sizes checked before and during reading; PerdureError if damaged."""

    def __init__(self, data: bytes, what: str) -> None:
        self._what = what
        missing = f"{what} is not a zip archive, or its end is missing"
        if data.count(_ENTRY) > MAX_MEMBERS:
            raise PerdureError(f"{what} has more than {MAX_MEMBERS:,} members; it is not a model")
        try:
            self._archive = zipfile.ZipFile(io.BytesIO(data))
        except (zipfile.BadZipFile, ValueError, OverflowError, NotImplementedError, OSError):
            raise PerdureError(missing) from None
        self._members = {member.filename: member for member in self._archive.infolist()}
        if min((member.header_offset for member in self._members.values()), default=0):
            # A model contains archives. Where its own end is missing, `zipfile` finds the end of one of these.
            raise PerdureError(missing)

    @property
    def names(self) -> list[str]:
        """Names of all members."""
        return list(self._members)

    def read(self, name: str, limit: int) -> bytes:
        """Return a member's contents.

        Args:
            name: The member.
            limit: Largest size allowed, in bytes, unpacked.

        Raises:
            PerdureError: If it is missing, damaged or larger than the limit.
        """
        member = self._members.get(name)
        if member is None:
            raise PerdureError(f"{self._what} has no member {name!r}: no model of Stable-Baselines3; see {MANUAL}")
        if member.file_size > limit:
            raise PerdureError(
                f"{self._what}: {name!r} unpacks to {member.file_size:,} bytes; at most {limit:,} are read"
            )
        try:
            with self._archive.open(member) as file:
                data = file.read(limit + 1)
        except (zipfile.BadZipFile, zlib.error, lzma.LZMAError, EOFError, OSError, ValueError, RuntimeError):
            # The last one includes encrypted members and unknown ways of packing.
            raise PerdureError(f"{self._what}: {name!r} is damaged") from None
        if len(data) != member.file_size:
            raise PerdureError(f"{self._what}: {name!r} is damaged: its size is not the one it declares")
        return data


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
    """The tensors of a state dict, or of those in a dict, as "KEY.NAME"; numbers are read when they are asked for.

    `torch.save` (since version 1.6) writes a zip archive: a pickle that describes the tensors, and one member with the
    raw numbers of each storage. PerdureError if damaged, too large, or asking for functions that no state dict needs.
    """

    def __init__(self, data: bytes, what: str) -> None:
        self._what = what
        if data[:2] != b"PK":
            raise PerdureError(
                f"{what} is not a zip archive; PyTorch before 1.6 wrote other files: give --trust if you trust the file"
            )
        self._members = ZipMembers(data, what)
        descriptions = [name for name in self._members.names if name.count("/") == 1 and name.endswith("/data.pkl")]
        if len(descriptions) != 1:
            raise PerdureError(f"{what} does not hold exactly one state dict of PyTorch")
        self._folder = descriptions[0].removesuffix("data.pkl")
        if f"{self._folder}byteorder" in self._members.names and self._read("byteorder", 100) != b"little":
            raise PerdureError(f"{what} was written on a big-endian machine, which is not read")
        if f"{self._folder}constants.pkl" in self._members.names:
            raise PerdureError(f"{what} is TorchScript, which is code and not run; use ONNX: {MANUAL}#torchscript")
        state = read_pickle(self._read("data.pkl", MAX_DESCRIPTION), ALLOWED, what)
        parts = {"": state}
        if isinstance(state, dict):
            parts = {f"{name}.": part for name, part in state.items()}
        self._tensors = {}
        for prefix, part in parts.items():
            if isinstance(part, Stub):
                self._tensors.update({f"{prefix}{name}": tensor for name, tensor in part.items.items()})
        if not self._tensors:
            raise PerdureError(f"{what} is not a state dict of PyTorch")

    @property
    def names(self) -> list[str]:
        """Names of all entries, such as "actor.mu.weight"."""
        return list(self._tensors)

    def array(self, name: str) -> NDArray[np.float32]:
        """Return a tensor as a new array.

        Raises:
            PerdureError: If there is no such tensor, it is damaged, or not all of its numbers are finite.
        """
        try:
            array = self._build(self._tensors[name])
        except PerdureError:
            raise
        except (KeyError, TypeError, ValueError, AttributeError):
            raise PerdureError(f"{self._what}: {name!r} is not a tensor of floating-point numbers") from None
        with np.errstate(over="ignore"):
            result = np.array(array, np.float32, order="C")
        if not np.isfinite(result).all():
            raise PerdureError(f"{self._what}: the weights {name!r} hold numbers that are not finite")
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
        return np.frombuffer(self._read(f"data/{key}", MAX_STORAGE), _STORAGES[of.function])

    def _read(self, name: str, limit: int) -> bytes:
        return self._members.read(f"{self._folder}{name}", limit)
