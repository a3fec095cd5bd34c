"""Read JSON and Parquet: what does not fit its declaration is a `PerdureError` of one line.

What a JSON file may hold is declared as a `Record` or any other type that msgspec knows. What the columns of a table
may hold is declared as kinds (`Text`, `Whole`, `Real`, `Flag`, `Choice`): each gives the type for single values, and
the Polars expression of the rows that do not fit. The module imports no other part of perdure but its errors.
"""

from __future__ import annotations

import io
import json
import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, Literal

import msgspec
from msgspec import Meta

from perdure.errors import PerdureError

if TYPE_CHECKING:
    import polars as pl

LARGEST = 1e100
"""Numbers are at most this, so that their squares are numbers too."""
DEEPEST = 20
"""Lists and tables inside each other in one JSON file."""
_LONGEST_SHOWN = 60
"""Characters of a wrong value in a message."""
_UNSEEN = (
    "\x00-\x1f\x7f-\x9f"  # control characters, with them the escape that begins a terminal's commands
    "\u061c\u200e\u200f\u202a-\u202e\u2066-\u2069"  # marks that turn the direction of what follows
    "\u2028\u2029"  # separators that some programs take for line ends
    "\ud800-\udfff"  # surrogates: no text, and no encoding can write them
)
UNSEEN = re.compile(f"[{_UNSEEN}]")
"""Characters that change how other text is shown instead of being shown."""
_UNSEEN_BUT_LINES = re.compile(f"(?![\n\t])[{_UNSEEN}]")
_SHOWN = rf"\A[^{_UNSEEN}]*\Z"
Count = Annotated[int, Meta(ge=0, le=2**63 - 1)]
Number = Annotated[float, Meta(ge=-LARGEST, le=LARGEST)]
"""A finite number; an unbounded `float` may be infinite or nan."""
Line = Annotated[str, Meta(max_length=500, pattern=_SHOWN)]
"""A line of text that does nothing to a terminal."""
Name = Annotated[str, Meta(min_length=1, max_length=500, pattern=_SHOWN)]
Misfits = Callable[["pl.Expr"], "pl.Expr"]


class Record(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Base class of declared JSON tables with named fields."""


def checked(value: Any, kind: Any, name: str = "") -> Any:
    """Return a plain value (of JSON) as `kind`.

    Args:
        value: Numbers, text, lists and dictionaries.
        kind: A type that msgspec knows; types are not converted into each other, but an int may stand for a float.
        name: Of the value, for the message.

    Raises:
        PerdureError: It does not fit; with the place, what is allowed and what was found.
    """
    try:
        return msgspec.convert(value, kind)
    except (msgspec.ValidationError, ValueError, RecursionError, OverflowError) as error:  # ValueError: lone surrogates
        text, _, place = str(error).replace("`", "").partition(" - at ")
        text = re.sub(r" matching regex .*", " without control characters", text, flags=re.DOTALL)
        where = f"{name}{place.replace('$', '')}".lstrip(".") or "it"
        if text.startswith("Expected") and not place and ", got" not in text:
            text += f", got {_shown(value)}"
        for part, words in _WORDS.items():
            text = text.replace(part, words)
        if not text.startswith(("must", "has")):
            where += ":"
        raise PerdureError(f"{where} {text}") from None


_WORDS = {
    "Expected ": "must be ",
    ", got ": ", not ",
    "Object missing required field": "has no",
    "Object contains unknown field": "must not have the field",
}
"""Parts of msgspec's messages, and the words that replace them."""


def read_json(text: str | bytes, kind: Any = Any) -> Any:
    """Return the value that JSON text describes, as `kind`.

    Infinity and NaN are read, as Python writes them: msgspec's own reader refuses them.

    Raises:
        PerdureError: The text is no JSON, is nested too deep, holds a number of too many digits, or is no `kind`.
    """
    try:
        value = json.loads(text)
    except (ValueError, RecursionError) as error:  # a UnicodeDecodeError and a JSONDecodeError are ValueErrors
        reason = str(error)
        if isinstance(error, RecursionError):
            reason = "it is nested too deep"
        raise PerdureError(f"it is not readable JSON: {reason}") from None
    level = [value]
    for _ in range(DEEPEST + 1):
        below: list[Any] = []
        for each in level:
            if isinstance(each, dict):
                below += each.values()
            elif isinstance(each, list):
                below += each
        level = below
    if level:
        raise PerdureError(f"it is nested too deep: more than {DEEPEST} lists and tables inside each other")
    return value if kind is Any else checked(value, kind)


def printable(text: str, lines: bool = False) -> str:
    """Return text without characters that act on a terminal; each becomes the replacement character.

    Args:
        text: Of any origin.
        lines: Keep line ends and tabs.
    """
    pattern = _UNSEEN_BUT_LINES if lines else UNSEEN
    return pattern.sub("\ufffd", text)


class Parquet:
    """A Parquet file in memory.

    Raises:
        PerdureError: Polars cannot decode it; one line says why.
    """

    def __init__(self, content: bytes) -> None:
        import polars as pl

        self._content = content
        with _decoding():
            self.columns: dict[str, object] = dict(pl.read_parquet_schema(io.BytesIO(content)))
            """Name and type of each column."""
            notes = pl.read_parquet_metadata(io.BytesIO(content))
        self.notes = {name: value for name, value in notes.items() if name != "ARROW:schema"}
        """The key-value metadata."""

    def read(self, columns: Sequence[str] | None = None) -> pl.DataFrame:
        """Return the table, or some of its columns."""
        import polars as pl

        if columns is not None:
            columns = list(columns)
        with _decoding():
            return pl.read_parquet(io.BytesIO(self._content), columns=columns)


def parquet_bytes(frame: pl.DataFrame, **options: Any) -> bytes:
    """Return a table as a Parquet file; options are those of Polars' `write_parquet`."""
    buffer = io.BytesIO()
    frame.write_parquet(buffer, **options)
    return buffer.getvalue()


@contextmanager
def _decoding() -> Iterator[None]:
    import polars as pl

    try:
        yield
    except (pl.exceptions.PolarsError, pl.exceptions.PanicException, OSError, MemoryError) as error:
        reason = (str(error).splitlines() or [type(error).__name__])[0][:200]
        raise PerdureError(f"it is not a readable Parquet file: {reason}") from None


# What the columns of a table may hold


class Kind:
    """What a value, or every value of a column, may be."""

    def __init__(self, type: Any, allowed: str = "", misfits: Misfits = lambda column: column.is_null()) -> None:
        self.type = type
        """As msgspec knows it."""
        self.allowed = allowed
        """In words."""
        self.misfits = misfits
        """Returns the rows of a column, which has the right type already, that do not fit."""

    def check(self, value: Any, where: str = "") -> None:
        """Raise PerdureError, with `where` and what is allowed, unless a value is of this kind."""
        try:
            checked(value, self.type, where)
        except PerdureError:
            if not self.allowed:
                raise
            raise PerdureError(f"{where or 'it'} must be {self.allowed}, not {_shown(value)}") from None


def _shown(value: Any) -> str:
    text = repr(value)
    if len(text) > _LONGEST_SHOWN:
        return f"{text[:_LONGEST_SHOWN]}..."
    return text


class Text(Kind):
    """Text without control characters."""

    def __init__(self, longest: int = 500, shortest: int = 0) -> None:
        pattern = UNSEEN.pattern.replace("\ud800-\udfff", "")  # in UTF-8 there are no surrogates
        super().__init__(
            Annotated[str, Meta(min_length=shortest, max_length=longest, pattern=_SHOWN)],
            f"text of {shortest} to {longest} characters without control characters",
            lambda column: ~column.str.len_chars().is_between(shortest, longest) | column.str.contains(pattern),
        )


class Whole(Kind):
    """A whole number."""

    def __init__(self, low: int = -(2**63), high: int = 2**63 - 1) -> None:
        limited = Annotated[int, Meta(ge=low, le=high)]
        super().__init__(limited, f"a whole number from {low} to {high}", lambda column: ~column.is_between(low, high))


class Real(Kind):
    """A number, finite unless `infinite` (where a bound is LARGEST) or `unknown` (nan); `above`: not `low` itself."""

    def __init__(
        self,
        low: float = -LARGEST,
        high: float = LARGEST,
        above: bool = False,
        infinite: bool = False,
        unknown: bool = False,
    ) -> None:
        begin = "above" if above else "from"
        words = f"a number {begin} {low:g} to {high:g}" + " or infinite" * infinite + " or nan" * unknown
        if infinite and abs(low) >= LARGEST:
            low *= math.inf
        if infinite and abs(high) >= LARGEST:
            high *= math.inf
        lower_name = "gt" if above else "ge"
        limits: Any = {name: bound for name, bound in ((lower_name, low), ("le", high)) if math.isfinite(bound)}

        def misfits(column: pl.Expr) -> pl.Expr:
            fits = column.is_between(low, high, closed="right" if above else "both")
            if unknown:
                fits |= column.is_nan()
            return ~fits

        value_type: Any = float
        if not unknown:
            value_type = Annotated[float, Meta(**limits)]
        super().__init__(value_type, words, misfits)
        self.holds: Callable[[float], bool] = lambda value: not unknown or value != value or low <= value <= high
        """Whether a number is allowed: msgspec has no bounds that let nan pass."""


class Flag(Kind):
    """True or False."""

    def __init__(self) -> None:
        super().__init__(bool, "true or false")


class Choice(Kind):
    """One of some words."""

    def __init__(self, words: Sequence[str]) -> None:
        self.words = tuple(words)
        allowed = f"one of {', '.join(map(repr, self.words))}"
        super().__init__(Literal[self.words], allowed, lambda column: ~column.is_in(list(self.words)))


class Maybe(Kind):
    """A value or nothing (null)."""

    def __init__(self, kind: Kind) -> None:
        super().__init__(kind.type | None, kind.allowed)


class Items(Kind):
    """A list of values of one kind."""

    def __init__(self, kind: Kind, shortest: int = 0, longest: int = 10_000_000) -> None:
        super().__init__(Annotated[list[kind.type], Meta(min_length=shortest, max_length=longest)])  # type: ignore[name-defined]


class Table(Kind):
    """Named fields, and rules between the columns of these names."""

    def __init__(self, fields: Mapping[str, Kind], rules: Sequence[Rule] = ()) -> None:
        self.fields = fields
        self.rules = rules
        names = {name: f"field_{number}" for number, name in enumerate(fields)}

        def check(made: Any) -> None:
            for name, kind in fields.items():
                if isinstance(kind, Real) and not kind.holds(made[name]):
                    raise ValueError(f"{name} must be {kind.allowed}, not {made[name]}")

        row: Any = msgspec.defstruct(
            "Table",
            [(names[name], kind.type) for name, kind in fields.items()],
            namespace={"__getitem__": lambda table, name: getattr(table, names[name]), "__post_init__": check},
            rename={short: name for name, short in names.items()},
            forbid_unknown_fields=True,
            kw_only=True,
        )
        super().__init__(row)


@dataclass(frozen=True)
class Rule:
    """What the columns of a table must have in common."""

    sentence: str
    """What must hold."""
    broken: Callable[[Callable[[str], Any]], Any]
    """Given a function from a field's name to its column, says where the rule is broken."""


def check_columns(column: Callable[[str], pl.Series], table: Table) -> None:
    """Check every row of a table whose columns have the right types already, a few columns at a time.

    Args:
        column: Returns the column of a name, such as `DataFrame.get_column`.
        table: What is declared.

    Raises:
        PerdureError: With the first row that does not fit, counted from 0.
    """
    import polars as pl

    for name, kind in table.fields.items():
        values = column(name)
        if values.null_count():
            raise PerdureError(f"it has missing values in column {name!r}")
        row = _first(values.to_frame(), kind.misfits(pl.col(name)))
        if row is not None:
            raise PerdureError(f"row {row}: {name} must be {kind.allowed}, not {_shown(values[row])}")
    for rule in table.rules:
        wrong = rule.broken(pl.col)
        row = _first(pl.DataFrame([column(name) for name in dict.fromkeys(wrong.meta.root_names())]), wrong)
        if row is not None:
            raise PerdureError(f"row {row}: {rule.sentence}")


def _first(frame: pl.DataFrame, wrong: pl.Expr) -> int | None:
    """Return the number of the first row where an expression is true; None without one."""
    row, any_wrong = frame.select(wrong.arg_max().alias("row"), wrong.any().alias("any")).row(0)
    if not any_wrong:
        return None
    return int(row)
