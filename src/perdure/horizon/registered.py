"""Look up embeddings, clocks and distributions by name, and convert them to and from JSON.

A class is found by its ``name`` as soon as it subclasses ``Embedding``, ``Clock`` or ``HorizonDistribution``: a new
one is one new file, imported in ``__init__.py`` or anywhere else.
"""

from __future__ import annotations

import dataclasses
import difflib
import inspect
import math
from abc import ABC
from typing import Any, ClassVar, TypeVar, get_type_hints

from perdure.horizon.errors import HorizonError
from perdure.schema import Anything, Kind, Real, SchemaError, Table, Whole

T = TypeVar("T")

LARGEST_COUNT = 100_000_000
"""Of steps or of components, in files."""


class Registered(ABC):
    """Base class of embeddings, clocks and distributions: frozen dataclasses of numbers."""

    name: ClassVar[str]
    """Name in files and on command lines."""

    def to_json(self) -> dict[str, Any]:
        """Return ``{"name": ..., field: value, ...}``.

        Infinity, which JSON does not have, becomes the string "inf"; NumPy numbers become Python's.
        """
        fields = dataclasses.fields(self)  # type: ignore[arg-type]
        return {"name": self.name, **{each.name: _plain(getattr(self, each.name)) for each in fields}}


def from_json(base: type[T], values: Any) -> T:
    """Return the instance of a subclass of ``base`` that its `to_json` described.

    Args:
        base: The abstract idea, such as ``Embedding``.
        values: ``{"name": ..., field: value, ...}``.

    Raises:
        HorizonError: If the name or a field is unknown, or a value is out of range.
    """
    kinds = known(base)
    name = values.get("name") if isinstance(values, dict) else values
    if not (isinstance(values, dict) and isinstance(name, str) and name in kinds):
        nearest = difflib.get_close_matches(str(name)[:80], kinds, n=1)
        hint = f"; did you mean {nearest[0]!r}?" if nearest else ""
        valid = ", ".join(sorted(kinds))
        raise HorizonError(f"unknown {base.__name__} {repr(name)[:80]}; the known ones are {valid}{hint}")
    fields = {key: math.inf if value == "inf" else value for key, value in values.items() if key != "name"}
    try:
        _declared(kinds[name]).check(fields)
        return kinds[name](**fields)
    except (SchemaError, TypeError) as error:
        raise HorizonError(f"{base.__name__} {name!r} cannot be built from {str(fields)[:200]}: {error}") from None


def _declared(kind: type) -> Table:
    """Return what a file may say of a class: its fields, by their types; its own rules it checks itself."""
    types = get_type_hints(kind)
    fields = {each.name: _KINDS.get(types[each.name], Anything()) for each in dataclasses.fields(kind)}
    needed = {each.name for each in dataclasses.fields(kind) if each.default is each.default_factory}
    return Table(
        {name: each for name, each in fields.items() if name in needed},
        optional={name: each for name, each in fields.items() if name not in needed},
    )


_KINDS: dict[Any, Kind] = {int: Whole(-LARGEST_COUNT, LARGEST_COUNT), float: Real(infinite=True)}


def known(base: type[T]) -> dict[str, type[T]]:
    """Return the concrete subclasses of ``base`` by name.

    Args:
        base: The abstract idea, such as ``Embedding``.

    Raises:
        HorizonError: If two of them have the same name, as after copying a file: a stored name must mean one thing.
    """
    kinds: dict[str, type[T]] = {}
    for kind in _subclasses(base):
        if inspect.isabstract(kind):
            continue
        name = kind.name  # type: ignore[attr-defined]
        other = kinds.setdefault(name, kind)
        if _path(other) != _path(kind):
            raise HorizonError(f"{_path(other)} and {_path(kind)} are both named {name!r}: give one another name")
    return kinds


def _plain(value: Any) -> Any:
    value = value.item() if hasattr(value, "item") else value
    return "inf" if value == math.inf else value


def _path(kind: type) -> str:
    return f"{kind.__module__}.{kind.__qualname__}"


def _subclasses(base: type[T]) -> list[type[T]]:
    direct = base.__subclasses__()
    return [*direct, *(kind for each in direct for kind in _subclasses(each))]
