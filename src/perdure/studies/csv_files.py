"""Read and write small tables as CSV: equal numbers give equal bytes."""

from __future__ import annotations

from pathlib import Path

import polars as pl

from perdure.runs import write_atomic

DIGITS = 6


def write_csv(path: Path, frame: pl.DataFrame) -> Path:
    """Write a frame as CSV with six significant digits; missing and undefined values are empty."""
    numbers = [name for name, kind in frame.schema.items() if kind in (pl.Float64, pl.Float32)]
    rounded = frame.with_columns(pl.col(name).fill_nan(None).round_sig_figs(DIGITS) for name in numbers)
    return write_atomic(path, rounded.write_csv())
