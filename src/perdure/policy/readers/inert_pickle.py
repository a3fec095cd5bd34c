"""Read a pickle as data: nothing is imported and nothing is called.

A pickle is a program for a stack machine. This reader carries out the instructions that build plain values. Where the
program asks for a function or a class by name, the name must be on the caller's list, and the call is written down as a
`Call` instead of being made. Format: `pickletools` in Python's standard library.
"""

from __future__ import annotations

import pickletools
import warnings
from collections.abc import Callable, Collection
from dataclasses import dataclass, field
from typing import Any

from perdure.policy.errors import PolicyFileError

PERSISTENT = "persistent id"
"""Function name of a `Call` that stands for an object kept outside the pickle."""


@dataclass(frozen=True)
class Name:
    """A function or class that the pickle refers to, such as "numpy.dtype"."""

    path: str


@dataclass(eq=False)
class Call:
    """A call in the pickle. It is never made."""

    function: str
    arguments: tuple[Any, ...]
    state: Any = None
    """What the object would be filled with (`__setstate__`)."""
    items: dict[Any, Any] = field(default_factory=dict)
    """Entries, if the object is a mapping."""


def read_pickle(data: bytes, allowed: Collection[str], what: str) -> Any:
    """Return what a pickle describes, with every call left as a `Call`.

    Args:
        data: The pickle.
        allowed: Full names of the functions and classes that may occur.
        what: Which file it is, for messages.

    Raises:
        PolicyFileError: If it is damaged, or asks for a function or class that is not allowed.
    """
    machine = _Machine(allowed, what)
    try:
        with warnings.catch_warnings(action="ignore"):  # Python's own reader warns of odd texts
            for opcode, argument, _ in pickletools.genops(data):
                if opcode.name == "STOP":
                    return machine.pop()
                machine.carry_out(opcode.name, argument)
    except PolicyFileError:
        raise
    except (ValueError, LookupError, TypeError, OverflowError, MemoryError) as error:
        raise PolicyFileError(f"{what} is damaged, or not a pickle: {type(error).__name__}") from None
    raise PolicyFileError(f"{what} is damaged: its end is missing")


class _Machine:
    """The stack, the marks on it and the memo of one pickle."""

    def __init__(self, allowed: Collection[str], what: str) -> None:
        self._allowed, self._what = allowed, what
        self._stack: list[Any] = []
        self._marks: list[int] = []
        self._memo: dict[int, Any] = {}

    def pop(self) -> Any:
        """Remove and return the topmost value."""
        return self._stack.pop()

    def carry_out(self, name: str, argument: Any) -> None:
        """Carry out one instruction."""
        if name in _IGNORED:
            return
        if name in _LITERALS:
            self._stack.append(argument)
        elif name in _CONSTANTS:
            self._stack.append(_CONSTANTS[name]())
        elif name in _ACTIONS:
            _ACTIONS[name](self, argument)
        else:
            raise PolicyFileError(f"{self._what} uses the pickle instruction {name}, which is not read")

    def _mark(self, _: Any) -> None:
        self._marks.append(len(self._stack))

    def _since_mark(self) -> list[Any]:
        start = self._marks.pop()
        values = self._stack[start:]
        del self._stack[start:]
        return values

    def _tuple(self, _: Any) -> None:
        self._stack.append(tuple(self._since_mark()))

    def _short_tuple(self, length: int) -> None:
        values = tuple(self._stack[-length:])
        if len(values) < length:
            raise IndexError
        self._stack[-length:] = [values]

    def _append(self, _: Any) -> None:
        value = self.pop()
        self._extend([value])

    def _appends(self, _: Any) -> None:
        self._extend(self._since_mark())

    def _extend(self, values: list[Any]) -> None:
        if not isinstance(self._stack[-1], list):
            raise TypeError
        self._stack[-1].extend(values)

    def _set_item(self, _: Any) -> None:
        value, key = self.pop(), self.pop()
        self._update([key, value])

    def _set_items(self, _: Any) -> None:
        self._update(self._since_mark())

    def _update(self, pairs: list[Any]) -> None:
        target = self._stack[-1]
        entries = target.items if isinstance(target, Call) else target
        # Nested tuples as keys could take for ever to hash.
        if not isinstance(entries, dict) or not all(isinstance(key, str | int | float | None) for key in pairs[::2]):
            raise TypeError
        entries.update(zip(pairs[::2], pairs[1::2], strict=True))

    def _global(self, argument: str) -> None:
        self._name(*argument.split(" ", 1))

    def _stack_global(self, _: Any) -> None:
        name, module = self.pop(), self.pop()
        self._name(module, name)

    def _name(self, module: str, name: str) -> None:
        if not isinstance(module, str) or not isinstance(name, str):
            raise TypeError
        path = f"{module}.{name}"
        if path not in self._allowed:
            raise PolicyFileError(
                f"{self._what} asks for the Python object {path[:100]!r}, which was not run; if you trust the file, "
                "give --trust (trust=True in Python)"
            )
        self._stack.append(Name(path))

    def _call(self, _: Any) -> None:
        arguments, function = self.pop(), self.pop()
        if not isinstance(function, Name) or not isinstance(arguments, tuple):
            raise TypeError
        self._stack.append(Call(function.path, arguments))

    def _build(self, _: Any) -> None:
        state = self.pop()
        if not isinstance(self._stack[-1], Call):
            raise TypeError
        self._stack[-1].state = state

    def _persistent(self, _: Any) -> None:
        self._stack.append(Call(PERSISTENT, (self.pop(),)))

    def _remember(self, place: int) -> None:
        self._memo[place] = self._stack[-1]

    def _memoize(self, _: Any) -> None:
        self._memo[len(self._memo)] = self._stack[-1]

    def _recall(self, place: int) -> None:
        self._stack.append(self._memo[place])


_IGNORED = frozenset({"PROTO", "FRAME"})
_LITERALS = frozenset(
    {
        *("BININT", "BININT1", "BININT2", "LONG1", "BINFLOAT"),
        *("BINUNICODE", "SHORT_BINUNICODE", "BINBYTES", "SHORT_BINBYTES", "BINBYTES8", "BYTEARRAY8"),
    }
)
_CONSTANTS: dict[str, Callable[[], Any]] = {
    "NONE": lambda: None,
    "NEWTRUE": lambda: True,
    "NEWFALSE": lambda: False,
    "EMPTY_TUPLE": tuple,
    "EMPTY_LIST": list,
    "EMPTY_DICT": dict,
}
_ACTIONS: dict[str, Callable[[_Machine, Any], None]] = {
    "MARK": _Machine._mark,
    "TUPLE": _Machine._tuple,
    "TUPLE1": lambda machine, _: machine._short_tuple(1),
    "TUPLE2": lambda machine, _: machine._short_tuple(2),
    "TUPLE3": lambda machine, _: machine._short_tuple(3),
    "APPEND": _Machine._append,
    "APPENDS": _Machine._appends,
    "SETITEM": _Machine._set_item,
    "SETITEMS": _Machine._set_items,
    "GLOBAL": _Machine._global,
    "STACK_GLOBAL": _Machine._stack_global,
    "REDUCE": _Machine._call,
    "NEWOBJ": _Machine._call,
    "BUILD": _Machine._build,
    "BINPERSID": _Machine._persistent,
    "BINPUT": _Machine._remember,
    "LONG_BINPUT": _Machine._remember,
    "MEMOIZE": _Machine._memoize,
    "BINGET": _Machine._recall,
    "LONG_BINGET": _Machine._recall,
}
