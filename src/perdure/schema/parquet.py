"""Parquet of unknown origin, decoded by Polars without its panics on standard error."""

from __future__ import annotations

import io
import os
import tempfile
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING

from perdure.schema.errors import SchemaError

if TYPE_CHECKING:
    import polars as pl

_ONE_AT_A_TIME = threading.Lock()


def read_parquet(content: bytes, columns: Sequence[str] | None = None) -> pl.DataFrame:
    """Return the table in a Parquet file, or some of its columns.

    Raises:
        SchemaError: Polars cannot decode it; one line says why.
    """
    import polars as pl

    with _decoding():
        return pl.read_parquet(io.BytesIO(content), columns=None if columns is None else list(columns))


def read_columns(content: bytes) -> dict[str, object]:
    """Return name and type of each column of a Parquet file; SchemaError where Polars cannot read it."""
    import polars as pl

    with _decoding():
        return dict(pl.read_parquet_schema(io.BytesIO(content)))


def read_notes(content: bytes) -> dict[str, str]:
    """Return the key-value metadata of a Parquet file; SchemaError where Polars cannot read it."""
    import polars as pl

    with _decoding():
        notes = pl.read_parquet_metadata(io.BytesIO(content))
    return {name: value for name, value in notes.items() if name != "ARROW:schema"}


@contextmanager
def _decoding() -> Iterator[None]:
    """Convert any error of Polars to a SchemaError."""
    import polars as pl

    try:
        with _quiet():
            yield
    except (
        *(pl.exceptions.PolarsError, pl.exceptions.PanicException, OSError, ValueError, TypeError, OverflowError),
        MemoryError,
    ) as error:
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        raise SchemaError(f"it is not a readable Parquet file: {reason[:200]}") from None


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep what native code writes to standard error away from the user: a panic prints pages before it is raised."""
    with _ONE_AT_A_TIME, tempfile.TemporaryFile() as swallowed:
        try:
            before = os.dup(2)
        except OSError:  # there is no standard error
            yield
            return
        os.dup2(swallowed.fileno(), 2)
        try:
            yield
        finally:
            with suppress(OSError):
                os.dup2(before, 2)
            os.close(before)
