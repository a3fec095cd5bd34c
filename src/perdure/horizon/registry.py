"""Embeddings, clocks and laws by name, as policy files store them.

A class is found by its ``name`` as soon as it subclasses the abstract idea (``Embedding``, ``Clock``, ``HorizonLaw``), so
a new one is one new file, imported in ``__init__.py``.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any, TypeVar

from perdure.horizon.errors import HorizonError

T = TypeVar("T")


def to_json(thing: Any) -> dict[str, Any]:
    """``{"name": ..., field: value, ...}`` of a frozen dataclass; infinity is written as the string "inf"."""
    fields = {field.name: getattr(thing, field.name) for field in dataclasses.fields(thing)}
    return {"name": thing.name, **{key: "inf" if value == math.inf else value for key, value in fields.items()}}


def from_json(base: type[T], values: Any) -> T:
    """The subclass of ``base`` that :func:`to_json` described.

    Raises:
        HorizonError: If the name or a field is unknown, or a value is out of range.
    """
    kinds = {kind.name: kind for kind in _subclasses(base)}  # type: ignore[attr-defined]
    if not isinstance(values, dict) or values.get("name") not in kinds:
        name = values.get("name") if isinstance(values, dict) else values
        raise HorizonError(f"unknown {base.__name__} {name!r}; the known ones are {', '.join(sorted(kinds))}")
    kind = kinds[values["name"]]
    fields = {key: math.inf if value == "inf" else value for key, value in values.items() if key != "name"}
    try:
        return kind(**fields)
    except TypeError as error:
        raise HorizonError(f"{base.__name__} {values['name']!r} cannot be built from {fields}: {error}") from None


def _subclasses(base: type[T]) -> list[type[T]]:
    direct = base.__subclasses__()
    return [*direct, *(kind for each in direct for kind in _subclasses(each))]
