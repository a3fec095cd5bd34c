"""Read and write small tables as CSV: equal numbers give equal bytes."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from pathlib import Path

import polars as pl

from perdure.runs import write_atomic
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
    try:
        text = pl.read_csv(path, infer_schema=False)
        if text.columns != list(schema):
            raise StudyError(f"{path}: its columns must be {', '.join(schema)}, not {', '.join(text.columns)}")
        if not path.read_bytes().endswith(b"\n"):
            raise StudyError(f"{path}: its last line is cut")
        for name in schema:
            if name not in optional and text[name].has_nulls():
                raise StudyError(f"{path}: row {text[name].is_null().arg_max()} has no {name}")
        return pl.read_csv(path, schema=schema)
    except pl.exceptions.PolarsError as error:
        raise StudyError(f"{path} is no readable CSV: {str(error).splitlines()[0]}") from None


def write_csv(path: Path, frame: pl.DataFrame) -> Path:
    """Write a frame as CSV with six significant digits; missing and undefined values are empty."""
    numbers = [name for name, kind in frame.schema.items() if kind in (pl.Float64, pl.Float32)]
    rounded = frame.with_columns(pl.col(name).fill_nan(None).round_sig_figs(DIGITS) for name in numbers)
    return write_atomic(path, rounded.write_csv())
