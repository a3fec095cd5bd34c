"""Embeddings, clocks and distributions by name, as policy files store them.

A class is found by its ``name`` as soon as it subclasses ``Embedding``, ``Clock`` or ``HorizonDistribution``: a new
one is one new file, imported in ``__init__.py`` or anywhere else.
"""

from __future__ import annotations

import dataclasses
import difflib
import inspect
import math
from typing import Any, TypeVar

from perdure.horizon.errors import HorizonError

T = TypeVar("T")


def to_json(thing: Any) -> dict[str, Any]:
    """``{"name": ..., field: value, ...}`` of a frozen dataclass of numbers.

    Args:
        thing: An embedding, a clock or a distribution. Infinity, which JSON does not have, becomes the string "inf";
            NumPy numbers become Python's.
    """
    return {"name": thing.name, **{f.name: _plain(getattr(thing, f.name)) for f in dataclasses.fields(thing)}}


def from_json(base: type[T], values: Any) -> T:
    """The subclass of ``base`` that :func:`to_json` described.

    Args:
        base: The abstract idea, such as ``Embedding``.
        values: ``{"name": ..., field: value, ...}``.

    Raises:
        HorizonError: If the name or a field is unknown, or a value is out of range.
    """
    kinds = known(base)
    name = values.get("name") if isinstance(values, dict) else values
    if not (isinstance(values, dict) and isinstance(name, str) and name in kinds):
        nearest = difflib.get_close_matches(str(name), kinds, n=1)
        hint = f"; did you mean {nearest[0]!r}?" if nearest else ""
        valid = ", ".join(sorted(kinds))
        raise HorizonError(f"unknown {base.__name__} {name!r}; the known ones are {valid}{hint}")
    fields = {key: math.inf if value == "inf" else value for key, value in values.items() if key != "name"}
    try:
        return kinds[name](**fields)
    except TypeError as error:
        raise HorizonError(f"{base.__name__} {name!r} cannot be built from {fields}: {error}") from None


def known(base: type[T]) -> dict[str, type[T]]:
    """The concrete subclasses of ``base`` by name.

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
