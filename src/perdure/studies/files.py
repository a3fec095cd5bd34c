"""Read what steps of a study left, and write small tables as CSV: equal numbers give equal bytes."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

import polars as pl

from perdure.runs import write_atomic
from perdure.schema import Kind, Parquet, SchemaError, read_json
from perdure.studies.errors import StudyError

DIGITS = 6


def read_csv(path: Path, schema: Mapping[str, type[pl.DataType]], optional: Collection[str] = ()) -> pl.DataFrame:
    """Return a table; it has no rows if the file does not exist.

    Args:
        path: Of a file that `write_csv` wrote.
        schema: Column to type, in order.
        optional: Columns that may have empty cells.

    Raises:
        StudyError: The file is damaged, or has other columns.
    """
    if not path.is_file():
        return pl.DataFrame(schema=schema)
    content = path.read_bytes()
    try:
        text = pl.read_csv(content, infer_schema=False)
        if text.columns != list(schema):
            raise StudyError(f"{path}: its columns must be {', '.join(schema)}, not {', '.join(text.columns)}")
        if not content.endswith(b"\n"):
            raise StudyError(f"{path}: its last line is cut")
        for name in schema:
            if name not in optional and text[name].has_nulls():
                raise StudyError(f"{path}: row {text[name].is_null().arg_max()} has no {name}")
        return pl.read_csv(content, schema=schema)
    except pl.exceptions.PolarsError as error:
        raise StudyError(f"{path} is no readable CSV: {str(error).splitlines()[0]}") from None


def write_csv(path: Path, frame: pl.DataFrame) -> Path:
    """Write a frame as CSV with six significant digits; missing and undefined values are empty."""
    numbers = [name for name, kind in frame.schema.items() if kind in (pl.Float64, pl.Float32)]
    rounded = frame.with_columns(pl.col(name).fill_nan(None).round_sig_figs(DIGITS) for name in numbers)
    return write_atomic(path, rounded.write_csv())


def read_json_file(path: Path, kind: Kind) -> Any:
    """Return the value in a JSON file.

    Raises:
        StudyError: The file is damaged, or holds something else than `kind`.
    """
    try:
        value = read_json(path.read_bytes())
        kind.check(value, "")
    except SchemaError as error:
        raise StudyError(f"{path}: {error}") from None
    return value


def read_parquet_file(path: Path) -> pl.DataFrame:
    """Return the table in a Parquet file that a step of a study wrote.

    Raises:
        StudyError: The file is damaged.
    """
    try:
        return Parquet(path.read_bytes()).read()
    except SchemaError as error:
        raise StudyError(f"{path}: {error}") from None
