"""The process in which `parquet.py` has a Parquet file decoded before it decodes it itself.

A flipped bit in a length makes Polars ask for memory that no machine has, and then abort its process. Here it aborts a
process that nobody misses.
"""

from __future__ import annotations

import io
import json
import sys


def serve() -> None:
    """Decode files from standard input: for a line with a size and so many bytes, write a line, "null" or the error."""
    while line := sys.stdin.buffer.readline():
        content = sys.stdin.buffer.read(int(line))
        print(json.dumps(_error(content)), flush=True)


def _error(content: bytes) -> str | None:
    import polars as pl

    try:
        pl.read_parquet_metadata(io.BytesIO(content))
        for name in pl.read_parquet_schema(io.BytesIO(content)):  # one column at a time: a table may be large
            pl.read_parquet(io.BytesIO(content), columns=[name])
    except (KeyboardInterrupt, SystemExit):
        raise
    except BaseException as problem:  # a panic of Polars is no Exception
        return (str(problem).splitlines() or [type(problem).__name__])[0][:200]
    return None
