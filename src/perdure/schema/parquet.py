"""Parquet of unknown origin, decoded by Polars in a process of its own: see `decoder.py`."""

from __future__ import annotations

import atexit
import io
import json
import os
import subprocess
import sys
import threading
from collections.abc import Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from perdure.schema.errors import SchemaError

if TYPE_CHECKING:
    import polars as pl

SERVE = "import sys, json; sys.path[:] = json.loads(sys.argv[1]); from perdure.schema.decoder import serve; serve()"


def read_parquet(content: bytes, columns: Sequence[str] | None = None) -> pl.DataFrame:
    """Return the table in a Parquet file, or some of its columns.

    Raises:
        SchemaError: Polars cannot decode it; one line says why.
    """
    return _frame(_decoder.ask(content, "table", columns))


def read_columns(content: bytes) -> dict[str, object]:
    """Return name and type of each column of a Parquet file; SchemaError where Polars cannot read it."""
    return dict(_frame(_decoder.ask(content, "schema")).schema)


def read_notes(content: bytes) -> dict[str, str]:
    """Return the key-value metadata of a Parquet file; SchemaError where Polars cannot read it."""
    return dict(json.loads(_decoder.ask(content, "notes")))


def _frame(answer: bytes) -> pl.DataFrame:
    import polars as pl

    return pl.read_ipc(io.BytesIO(answer))


class _Decoder:
    """The decoding process: started when it is needed, and again when it has ended or this process is a fork."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._process: subprocess.Popen[bytes] | None = None
        self._owner = 0
        self._content: bytes | None = None

    def ask(self, content: bytes, what: str, columns: Sequence[str] | None = None) -> bytes:
        """Return the answer to a request; SchemaError if there is none."""
        with self._lock:
            try:
                error, answer = self._exchange(content, what, columns)
            except (OSError, ValueError):  # no answer, or half of one
                self.end()
                error, answer = "Polars gave up its process over it", b""
            except BaseException:  # an interrupt: the rest of the answer must not be taken for the next one
                self.end()
                raise
        if error is not None:
            raise SchemaError(f"it is not a readable Parquet file: {error}")
        return answer

    def _exchange(self, content: bytes, what: str, columns: Sequence[str] | None) -> tuple[str | None, bytes]:
        process = self._running()
        assert process.stdin is not None
        assert process.stdout is not None
        known = content is self._content
        request = {
            "what": what,
            "columns": None if columns is None else list(columns),
            "size": 0 if known else len(content),
        }
        self._content = content
        process.stdin.write(json.dumps(request).encode() + b"\n" + (b"" if known else content))
        process.stdin.flush()
        head: dict[str, Any] = json.loads(process.stdout.readline())
        answer = process.stdout.read(head["size"])
        if len(answer) < head["size"]:
            raise OSError
        return head["error"], answer

    def _running(self) -> subprocess.Popen[bytes]:
        if self._process is None or self._owner != os.getpid() or self._process.poll() is not None:
            self.end()
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-c", SERVE, json.dumps(sys.path)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                start_new_session=True,  # Ctrl-C is for the user's process, whose end ends this one
            )
            self._owner = os.getpid()
        return self._process

    def end(self) -> None:
        """End the process if this process started it."""
        if self._process is not None and self._owner == os.getpid():
            self._process.kill()
            self._process.wait()
            for pipe in (self._process.stdin, self._process.stdout):
                with suppress(OSError):
                    pipe.close()  # type: ignore[union-attr]
        self._process = self._content = None


_decoder = _Decoder()
atexit.register(_decoder.end)
