"""Vocabularies: classes that files and command lines name.

A vocabulary is an abstract subclass of `Registered`: clocks, embeddings, distributions of the training horizon,
disturbances and others. A concrete subclass belongs to it as soon as it is defined. It carries its name, its words, its
bounds and their source, so to add one means to write one class.

A class in another package is found through an entry point. Its package declares the module that defines it in
pyproject.toml, and the module is imported before a name is looked up:

    [project.entry-points."perdure.plugins"]
    hourglass = "my_clocks"
"""

from __future__ import annotations

import inspect
import math
from abc import ABC
from dataclasses import fields
from importlib.metadata import entry_points
from typing import Annotated, Any, ClassVar, Self, TypeVar, get_type_hints

from msgspec import Meta

from perdure.errors import PerdureError, did_you_mean
from perdure.schema import checked

ENTRY_POINTS = "perdure.plugins"
"""Group of entry points: modules of other packages that define members of vocabularies."""
_T = TypeVar("_T")
_Whole = Annotated[int, Meta(ge=-100_000_000, le=100_000_000)]
"""Of steps or of components, in files."""
_loaded: list[bool] = []
"""Not empty once the modules of other packages are imported."""


def load_plugins() -> None:
    """Import the modules that installed packages declare under `ENTRY_POINTS`, once in a process."""
    if _loaded:
        return
    _loaded.append(True)  # before the imports: such a module may itself look a name up
    for entry in sorted(entry_points(group=ENTRY_POINTS), key=lambda each: each.name):
        entry.load()


class Registered(ABC):
    """Base class of the members of vocabularies, found by name; those that files store are frozen dataclasses."""

    name: ClassVar[str]
    """Name in files and on command lines."""

    def to_json(self) -> dict[str, Any]:
        """Return ``{"name": ..., field: value, ...}``.

        Infinity, which JSON does not have, becomes the string "inf"; NumPy numbers become Python's.
        """
        return {"name": self.name, **{each.name: _plain(getattr(self, each.name)) for each in fields(self)}}  # type: ignore[arg-type]

    @classmethod
    def from_json(cls, values: Any) -> Self:
        """Return the instance of a subclass that its `to_json` described, such as `Clock.from_json(values)`.

        Raises:
            PerdureError: If the name or a field is unknown, or a value is out of range.
        """
        kinds = cls.kinds()
        name = values.get("name") if isinstance(values, dict) else values
        if not (isinstance(values, dict) and isinstance(name, str) and name in kinds):
            valid = ", ".join(sorted(kinds))
            hint = did_you_mean(name, kinds)
            raise PerdureError(f"unknown {cls.__name__} {repr(name)[:80]}; the known ones are {valid}{hint}")
        given = {key: math.inf if value == "inf" else value for key, value in values.items() if key != "name"}
        try:
            for key, kind in get_type_hints(kinds[name]).items():
                if key in given and kind in (int, float):
                    checked(given[key], _Whole if kind is int else kind, key)
                    if given[key] != given[key]:
                        raise PerdureError(f"{key} must be a number, not nan")
            return kinds[name](**given)
        except (PerdureError, TypeError) as error:
            raise PerdureError(f"{cls.__name__} {name!r} cannot be built from {str(given)[:200]}: {error}") from None

    @classmethod
    def kinds(cls) -> dict[str, type[Self]]:
        """Return the concrete subclasses by name.

        Raises:
            PerdureError: If two of them have the same name, as after copying a file: a stored name must mean one thing.
        """
        load_plugins()
        found: dict[str, type[Self]] = {}
        for kind in _subclasses(cls):
            # A class without a name is a base that several members share.
            if hasattr(kind, "name") and not inspect.isabstract(kind):
                if _path(other := found.get(kind.name, kind)) != _path(kind):
                    raise PerdureError(
                        f"{_path(other)} and {_path(kind)} are both named {kind.name!r}: give one another name"
                    )
                found[kind.name] = kind  # the last definition, as after a cell of a notebook ran again
        return found


def _plain(value: Any) -> Any:
    value = value.item() if hasattr(value, "item") else value
    return "inf" if value == math.inf else value


def _path(kind: type) -> str:
    return f"{kind.__module__}.{kind.__qualname__}"


def _subclasses(base: type[_T]) -> list[type[_T]]:
    direct = base.__subclasses__()
    return [*direct, *(kind for each in direct for kind in _subclasses(each))]
