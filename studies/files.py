"""Read what units of a study left; write tables, and copy them into pages: equal numbers give equal bytes."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from pathlib import Path

import polars as pl

from perdure.errors import PerdureError
from perdure.runs import write_atomic
from perdure.schema import Parquet, parquet_bytes

DIGITS = 6


def read_csv(path: Path, schema: Mapping[str, type[pl.DataType]], optional: Collection[str] = ()) -> pl.DataFrame:
    """Return a table; it has no rows if the file does not exist.

    Args:
        path: Of a file that `write_csv` wrote.
        schema: Column to type, in order.
        optional: Columns that may have empty cells.

    Raises:
        PerdureError: The file is damaged, or has other columns.
    """
    if not path.is_file():
        return pl.DataFrame(schema=schema)
    content = path.read_bytes()
    try:
        text = pl.read_csv(content, infer_schema=False)
        if text.columns != list(schema):
            raise PerdureError(f"{path}: its columns must be {', '.join(schema)}, not {', '.join(text.columns)}")
        if not content.endswith(b"\n"):
            raise PerdureError(f"{path}: its last line is cut")
        for name in schema:
            if name not in optional and text[name].has_nulls():
                raise PerdureError(f"{path}: row {text[name].is_null().arg_max()} has no {name}")
        return pl.read_csv(content, schema=schema)
    except pl.exceptions.PolarsError as error:
        raise PerdureError(f"{path} is no readable CSV: {str(error).splitlines()[0]}") from None


def write_csv(path: Path, frame: pl.DataFrame) -> Path:
    """Write a frame as CSV with six significant digits; missing and undefined values are empty."""
    numbers = [name for name, kind in frame.schema.items() if kind in (pl.Float64, pl.Float32)]
    rounded = frame.with_columns(pl.col(name).fill_nan(None).round_sig_figs(DIGITS) for name in numbers)
    return write_atomic(path, rounded.write_csv())


def read_parquet_file(path: Path) -> pl.DataFrame:
    """Return the table in a Parquet file that a step of a study wrote.

    Raises:
        PerdureError: The file is damaged.
    """
    try:
        return Parquet(path.read_bytes()).read()
    except PerdureError as error:
        raise PerdureError(f"{path}: {error}") from None


def write_parquet_file(path: Path, frame: pl.DataFrame) -> Path:
    """Write a table as a small Parquet file."""
    return write_atomic(path, parquet_bytes(frame, compression="zstd", compression_level=19))


def markdown_table(frame: pl.DataFrame) -> str:
    """Return a table in Markdown; its cells are texts."""
    lines = [frame.columns, ["---"] * frame.width, *([str(cell or "") for cell in row] for row in frame.iter_rows())]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def include_tables(page: Path, tables: Mapping[str, pl.DataFrame]) -> Path:
    """Write the tables of a page again, each between `<!-- table: NAME -->` and `<!-- end -->`.

    Raises:
        PerdureError: The page names a table that is not there, or none: it is not a page of the study.
    """
    content = page.read_text()
    if "<!-- table: " not in content:
        raise PerdureError(f"{page} is not a page of the study, it includes no table; move it, or name another --out")

    def table(found: re.Match[str]) -> str:
        if found[1] not in tables:
            raise PerdureError(f"{page} includes the table {found[1]!r}; there are {', '.join(tables)}")
        return f"<!-- table: {found[1]} -->\n\n{markdown_table(tables[found[1]])}\n\n<!-- end -->"

    text = re.sub(r"<!-- table: (\S+) -->.*?<!-- end -->", table, content, flags=re.DOTALL)
    return write_atomic(page, text)
