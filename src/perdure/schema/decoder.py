"""The process in which `parquet.py` has a Parquet file decoded before it decodes it itself.

A flipped bit in a length makes Polars ask for memory that no machine has, and then abort. The abort then ends only this
process.
"""

from __future__ import annotations

import io
import json
import sys


def serve() -> None:
    """Decode files from standard input: for a line with a size and so many bytes, write a line, "null" or the error.

    The first line that is written says that it is ready.
    """
    import polars as pl

    print("ready", flush=True)
    while line := sys.stdin.buffer.readline():
        content, error = sys.stdin.buffer.read(int(line)), None
        try:
            pl.read_parquet_metadata(io.BytesIO(content))
            for name in pl.read_parquet_schema(io.BytesIO(content)):  # one column at a time: a table may be large
                pl.read_parquet(io.BytesIO(content), columns=[name])
        except (Exception, pl.exceptions.PanicException) as problem:
            error = (str(problem).splitlines() or [type(problem).__name__])[0][:200]
        print(json.dumps(error), flush=True)
