"""A declared table checked over the columns of a Polars frame."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, cast

from perdure.schema.errors import SchemaError
from perdure.schema.kinds import ColumnKind, Table, refuse

if TYPE_CHECKING:
    import polars as pl


def check_columns(column: Callable[[str], pl.Series], table: Table) -> None:
    """Check every row of a table whose columns have the right types already, a few columns at a time.

    Args:
        column: Returns the column of a name, such as `DataFrame.get_column`.
        table: What is declared.

    Raises:
        SchemaError: With the first row that does not fit, counted from 0.
    """
    import polars as pl

    for name, kind in table.fields.items():
        declared = cast(ColumnKind, kind)
        values = column(name)
        if values.null_count():
            raise SchemaError(f"it has missing values in column {name!r}")
        row = _first(values.to_frame(), declared.misfits(pl.col(name)))
        if row is not None:
            raise refuse(f"row {row}: {name}", values[row], declared.allowed)
    for rule in table.rules:
        wrong = rule.broken(pl.col)
        row = _first(pl.DataFrame([column(name) for name in dict.fromkeys(wrong.meta.root_names())]), wrong)
        if row is not None:
            raise SchemaError(f"row {row}: {rule.sentence}")


def _first(frame: pl.DataFrame, wrong: Any) -> int | None:
    found = frame.select(wrong.arg_max().alias("row"), wrong.any().alias("any")).row(0)
    return int(found[0]) if found[1] else None
