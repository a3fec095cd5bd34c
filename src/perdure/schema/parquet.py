"""Parquet of unknown origin, decoded by Polars in a separate process first: see `decoder.py`."""

from __future__ import annotations

import atexit
import io
import json
import os
import subprocess
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING

from perdure.schema.errors import SchemaError

if TYPE_CHECKING:
    import polars as pl

SERVE = "import sys, json; sys.path[:] = json.loads(sys.argv[1]); from perdure.schema.decoder import serve; serve()"
KEPT_BELOW = 2**20
"""Bytes. The process is kept for the next file, but not after a large one, whose memory it would keep too."""


class Parquet:
    """A Parquet file that Polars can decode.

    Raises:
        SchemaError: It cannot; one line says why.
        OSError: The separate process cannot be started.
    """

    def __init__(self, content: bytes) -> None:
        """Have the file decoded in the separate process."""
        if (error := _decoder.run(content)) is not None:
            raise SchemaError(f"it is not a readable Parquet file: {error}")
        self._content = content

    @property
    def columns(self) -> dict[str, object]:
        """Name and type of each column."""
        import polars as pl

        with _decoding():
            return dict(pl.read_parquet_schema(io.BytesIO(self._content)))

    @property
    def notes(self) -> dict[str, str]:
        """The key-value metadata."""
        import polars as pl

        with _decoding():
            notes = pl.read_parquet_metadata(io.BytesIO(self._content))
        return {name: value for name, value in notes.items() if name != "ARROW:schema"}

    def read(self, columns: Sequence[str] | None = None) -> pl.DataFrame:
        """Return the table, or some of its columns; SchemaError if a column is missing."""
        import polars as pl

        with _decoding():
            return pl.read_parquet(io.BytesIO(self._content), columns=None if columns is None else list(columns))


@contextmanager
def _decoding() -> Iterator[None]:
    import polars as pl

    try:
        yield
    except pl.exceptions.PolarsError as error:
        raise SchemaError(f"it is not a readable Parquet file: {error}") from None


class _Decoder:
    """The separate process: started when it is needed, and again when it has ended or this process is a fork."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._process: subprocess.Popen[bytes] | None = None
        self._owner = 0

    def run(self, content: bytes) -> str | None:
        """Return why a file cannot be decoded; None if it can."""
        with self._lock:
            process = self._running()
            answered = False
            try:
                error: str | None = self._ask(process, content)
                answered = True
            except (OSError, ValueError):  # no answer, or half of one
                error = "the process that decoded it ended (a damaged file, or out of memory)"
            finally:
                if not answered or len(content) > KEPT_BELOW:  # also after an interrupt: its answer is still to come
                    self.end()
            return error

    def _ask(self, process: subprocess.Popen[bytes], content: bytes) -> str | None:
        assert process.stdin is not None
        assert process.stdout is not None
        process.stdin.write(b"%d\n" % len(content))
        process.stdin.write(content)
        process.stdin.flush()
        answer: str | None = json.loads(process.stdout.readline())
        return answer

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
            assert self._process.stdout is not None
            ready = False
            try:
                ready = self._process.stdout.readline() == b"ready\n"
            finally:
                if not ready:  # also after an interrupt: the next answer would be this one
                    self.end()
            if not ready:
                raise OSError("the process that decodes Parquet files does not start")
        return self._process

    def end(self) -> None:
        """End the process if this process started it."""
        if self._process is not None and self._owner == os.getpid():
            self._process.kill()
            self._process.wait()
            for pipe in (self._process.stdin, self._process.stdout):
                with suppress(OSError):
                    pipe.close()  # type: ignore[union-attr]
        self._process = None


_decoder = _Decoder()
atexit.register(_decoder.end)
