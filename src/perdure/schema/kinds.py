"""Kinds of values a file may hold. Each checks a plain Python value; those without parts also check a whole column.

A check compares with operators only, so one declaration serves a value and a Polars expression alike.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from difflib import get_close_matches
from typing import Any, Protocol

import numpy as np

from perdure.schema.errors import SchemaError
from perdure.schema.text import UNSEEN

LONGEST_TEXT = 100_000
LARGEST = 1e100
"""Numbers are smaller than this, so that their squares are numbers too."""
_SHOWN = 60
_MANY = 40
"""Numbers from which on an array is quicker than a loop."""


class Kind(Protocol):
    """A kind of values."""

    def check(self, value: Any, where: str) -> None:
        """Raise SchemaError with `where` and the value when it is not of this kind."""


class ColumnKind(Kind, Protocol):
    """A kind of values that stand in the columns of a table."""

    @property
    def allowed(self) -> str:
        """What is allowed, for a message."""

    def misfits(self, column: Any) -> Any:
        """Return the Polars expression of rows whose value in `column` (an expression) is not of this kind."""


def refuse(where: str, value: Any, allowed: str) -> SchemaError:
    """Return the error that names a place, its value and what is allowed there."""
    shown = repr(value)
    shown = shown if len(shown) <= _SHOWN else f"{shown[:_SHOWN]}..."
    return SchemaError(f"{where} must be {allowed}, not {shown}")


@dataclass(frozen=True)
class Text:
    """One line of text without control characters."""

    longest: int = 500
    shortest: int = 0
    lines: bool = False
    """Whether it is free text: of any characters, for `printable` to clean where it is shown."""

    @property
    def allowed(self) -> str:
        """See `ColumnKind.allowed`."""
        least = f"{self.shortest} to " if self.shortest else "at most "
        return f"text of {least}{self.longest} characters" + ("" if self.lines else " without control characters")

    def check(self, value: Any, where: str) -> None:
        """See `Kind.check`."""
        fits = isinstance(value, str) and self.shortest <= len(value) <= self.longest
        if not fits or not (self.lines or UNSEEN.search(value) is None):
            raise refuse(where, value, self.allowed)

    def misfits(self, column: Any) -> Any:
        """See `ColumnKind.misfits`."""
        size = column.str.len_chars()
        wrong = (size > self.longest) | (size < self.shortest)
        if self.lines:
            return wrong
        pattern = UNSEEN.pattern.replace("\ud800-\udfff", "")  # in UTF-8 there are no surrogates
        return wrong | column.str.contains(pattern)


@dataclass(frozen=True)
class Whole:
    """A whole number."""

    low: int = -(2**63)
    high: int = 2**63 - 1

    @property
    def allowed(self) -> str:
        """See `ColumnKind.allowed`."""
        return f"a whole number from {self.low} to {self.high}"

    def check(self, value: Any, where: str) -> None:
        """See `Kind.check`."""
        if type(value) is not int or not self.low <= value <= self.high:
            raise refuse(where, value, self.allowed)

    def misfits(self, column: Any) -> Any:
        """See `ColumnKind.misfits`."""
        return (column < self.low) | (column > self.high)


@dataclass(frozen=True)
class Real:
    """A number. Without `infinite` and `unknown` it is finite."""

    low: float = -LARGEST
    high: float = LARGEST
    above: bool = False
    """Whether `low` itself is not allowed."""
    infinite: bool = False
    """Whether infinity is allowed on either side where the bound lies at LARGEST."""
    unknown: bool = False
    """Whether nan is allowed: the number is not known."""

    @property
    def allowed(self) -> str:
        """See `ColumnKind.allowed`."""
        least = f"above {self.low:g}" if self.above else f"from {self.low:g}"
        others = [word for word, given in (("infinite", self.infinite), ("nan", self.unknown)) if given]
        return f"a number {least} to {self.high:g}" + "".join(f" or {word}" for word in others)

    def check(self, value: Any, where: str) -> None:
        """See `Kind.check`."""
        if isinstance(value, bool) or not isinstance(value, int | float) or not self._fits(value):
            raise refuse(where, value, self.allowed)

    def check_many(self, values: Sequence[float], where: str) -> None:
        """Check many numbers at once."""
        try:
            array = np.asarray(values, dtype=np.float64)
        except (TypeError, ValueError, OverflowError):  # none is missing, or no number
            raise refuse(where, values, f"numbers, each {self.allowed}") from None
        if array.ndim != 1 or not set(map(type, values)) <= {int, float}:
            raise refuse(where, values, f"numbers, each {self.allowed}")
        inside = (array > self.low) if self.above else (array >= self.low)
        fits = (inside & (array <= self.high)) | (np.isnan(array) & self.unknown)
        if self.infinite:
            fits |= np.isinf(array) & np.where(array > 0, self.high >= LARGEST, self.low <= -LARGEST)
        if not fits.all():
            raise refuse(f"{where}[{int(np.argmin(fits))}]", float(array[np.argmin(fits)]), self.allowed)

    def misfits(self, column: Any) -> Any:
        """See `ColumnKind.misfits`."""
        low = -math.inf if self.infinite and self.low <= -LARGEST else self.low
        high = math.inf if self.infinite and self.high >= LARGEST else self.high
        below = (column <= low) if self.above else (column < low)
        wrong = below | (column > high)  # in Polars nan is larger than every number
        return wrong & ~column.is_nan() if self.unknown else wrong | column.is_nan()

    def _fits(self, value: float) -> bool:
        if value != value:
            return self.unknown
        if isinstance(value, int) and abs(value) > 2**53:  # as a float it would be another number
            return False
        if value in (math.inf, -math.inf):
            return self.infinite and (self.high >= LARGEST if value > 0 else self.low <= -LARGEST)
        return (self.low < value if self.above else self.low <= value) and value <= self.high


@dataclass(frozen=True)
class Flag:
    """True or False."""

    allowed = "true or false"

    def check(self, value: Any, where: str) -> None:
        """See `Kind.check`."""
        if not isinstance(value, bool):
            raise refuse(where, value, self.allowed)

    def misfits(self, column: Any) -> Any:
        """See `ColumnKind.misfits`: the column's type says it all."""
        return column & ~column


@dataclass(frozen=True)
class Choice:
    """One of some words."""

    words: Sequence[str]

    @property
    def allowed(self) -> str:
        """See `ColumnKind.allowed`."""
        return f"one of {', '.join(map(repr, self.words))}"

    def check(self, value: Any, where: str) -> None:
        """See `Kind.check`."""
        if not isinstance(value, str) or value not in self.words:
            raise refuse(where, value, self.allowed)

    def misfits(self, column: Any) -> Any:
        """See `ColumnKind.misfits`."""
        return ~column.is_in(list(self.words))


@dataclass(frozen=True)
class Maybe:
    """A value or nothing (null)."""

    kind: Kind

    def check(self, value: Any, where: str) -> None:
        """See `Kind.check`."""
        if value is not None:
            self.kind.check(value, where)


@dataclass(frozen=True)
class Items:
    """A list of values of one kind."""

    kind: Kind
    shortest: int = 0
    longest: int = 10_000_000

    def check(self, value: Any, where: str) -> None:
        """See `Kind.check`."""
        if not isinstance(value, list | tuple):
            raise refuse(where, value, "a list")
        if not self.shortest <= len(value) <= self.longest:
            raise SchemaError(f"{where} must hold {self.shortest} to {self.longest} values, not {len(value)}")
        if isinstance(self.kind, Real) and len(value) > _MANY:
            self.kind.check_many(value, where)
            return
        for number, item in enumerate(value):
            self.kind.check(item, f"{where}[{number}]")


@dataclass(frozen=True)
class Rule:
    """What the fields of one table must have in common."""

    sentence: str
    """What must hold."""
    broken: Callable[[Callable[[str], Any]], Any]
    """Given a function from a field's name to its value (or its column), says where the rule is broken. Written with
    operators only, and & and | for and and or."""


@dataclass(frozen=True)
class Table:
    """Named fields, and rules between them."""

    fields: Mapping[str, Kind]
    optional: Mapping[str, Kind] = field(default_factory=dict)
    rules: Sequence[Rule] = ()
    others: Kind | None = None
    """Of fields that are not named; None: there must be none."""

    def check(self, value: Any, where: str = "") -> None:
        """See `Kind.check`; an empty `where` names fields alone."""
        if not isinstance(value, Mapping) or not all(isinstance(name, str) for name in value):
            raise refuse(where or "it", value, f"a table with {', '.join(self.fields) or 'named fields'}")
        missing = [name for name in self.fields if name not in value]
        if missing:
            raise SchemaError(f"{where or 'it'} has no {', '.join(missing)}")
        kinds = {**self.fields, **self.optional}
        for name, item in value.items():
            place = f"{where}.{name}" if where else name
            kind = kinds.get(name, self.others)
            if kind is None:
                nearest = get_close_matches(name, kinds, n=1)
                hint = f"; did you mean {nearest[0]}?" if nearest else ""
                raise SchemaError(f"{place!r} is no field of {where or 'it'}{hint}")
            kind.check(item, place)
        for rule in self.rules:
            if rule.broken(value.__getitem__):
                raise SchemaError(f"{where}: {rule.sentence}" if where else rule.sentence)


@dataclass(frozen=True)
class Anything:
    """Any JSON value that is nested no deeper than `depth`."""

    depth: int = 20

    def check(self, value: Any, where: str) -> None:
        """See `Kind.check`."""
        level = [value]
        for _ in range(self.depth + 1):
            texts = [name for each in level if isinstance(each, Mapping) for name in each]
            texts += [each for each in level if isinstance(each, str)]
            if not all(isinstance(text, str) and len(text) <= LONGEST_TEXT for text in texts):
                raise SchemaError(f"{where} holds a text of more than {LONGEST_TEXT} characters")
            odd = [each for each in level if not isinstance(each, str | int | float | list | tuple | Mapping | None)]
            if odd:
                raise refuse(where, odd[0], "a JSON value")
            parts = [each.values() if isinstance(each, Mapping) else each for each in level if _has_parts(each)]
            level = [part for each in parts for part in each]
            if not level:
                return
        raise SchemaError(f"{where} is nested too deep")


def _has_parts(value: Any) -> bool:
    return isinstance(value, Mapping | list | tuple)
