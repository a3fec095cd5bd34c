"""The process in which `parquet.py` has Parquet decoded.

A flipped bit in a length makes Polars ask for memory that no machine has, and then abort its process. It aborts this
one instead of the user's.

A request is a line of JSON, {"what": "notes" | "schema" | "table", "columns": [...] | null, "size": bytes}, and the
file in so many bytes; size 0 means the file of the request before. The answer is a line of JSON, {"error": text | null,
"size": bytes}, and in so many bytes the notes as JSON or the table as Arrow IPC; a schema is a table without rows.
"""

from __future__ import annotations

import io
import json
import sys
from typing import Any


def serve() -> None:
    """Answer requests on standard input until it ends."""
    content = b""
    while line := sys.stdin.buffer.readline():
        request = json.loads(line)
        if request["size"]:
            content = sys.stdin.buffer.read(request["size"])
        try:
            answer, error = _answer(content, request), None
        except (KeyboardInterrupt, SystemExit):
            raise
        except BaseException as problem:  # a panic of Polars is no Exception
            answer, error = b"", (str(problem).splitlines() or [type(problem).__name__])[0][:200]
        sys.stdout.buffer.write(json.dumps({"error": error, "size": len(answer)}).encode() + b"\n" + answer)
        sys.stdout.buffer.flush()


def _answer(content: bytes, request: dict[str, Any]) -> bytes:
    import polars as pl

    if request["what"] == "notes":
        notes = pl.read_parquet_metadata(io.BytesIO(content))
        return json.dumps({name: value for name, value in notes.items() if name != "ARROW:schema"}).encode()
    table, buffer = io.BytesIO(content), io.BytesIO()
    frame = (
        pl.DataFrame(schema=pl.read_parquet_schema(table))
        if request["what"] == "schema"
        else pl.read_parquet(table, columns=request["columns"])
    )
    frame.write_ipc(buffer)
    return buffer.getvalue()
