"""Damaged Parquet is refused, even if Polars aborts its process over it."""

import io
import os
from contextlib import suppress

import polars as pl
import pytest

from perdure.schema import Parquet, SchemaError, parquet

FRAME = pl.DataFrame({"a": [1, None, 3], "b": [None, "x", "y"], "c": [[1.0], [], None]})


@pytest.fixture(scope="module")
def content():
    buffer = io.BytesIO()
    FRAME.write_parquet(buffer, metadata={"note": "text"})
    return buffer.getvalue()


def test_what_is_read_is_what_polars_reads(content):
    file = Parquet(content)
    assert file.read().equals(FRAME)
    assert file.read(["b"]).equals(FRAME.select("b"))
    assert file.columns == dict(FRAME.schema)
    assert file.notes == {"note": "text"}


def test_every_single_byte_may_be_damaged(content):
    buffer, ends = io.BytesIO(), set()
    pl.DataFrame({"a": [None if k % 7 == 0 else k for k in range(60)]}).write_parquet(buffer)
    for at in range(len(buffer.getvalue())):
        changed = bytearray(buffer.getvalue())
        changed[at] = 127
        try:
            file = Parquet(bytes(changed))
        except SchemaError as error:
            ends.add("aborted" if "process that decoded it ended" in str(error) else "refused")
        else:
            ends.add("read")
            with suppress(SchemaError):
                assert len(file.columns) == len(file.read().columns)
    assert ends == {"read", "refused", "aborted"}
    assert Parquet(content).read().equals(FRAME)


def test_a_process_that_was_killed_is_started_again(content):
    Parquet(content)
    parquet._decoder._process.kill()
    parquet._decoder._process.wait()
    assert Parquet(content).read().equals(FRAME)


def test_a_fork_starts_another_process(content):
    Parquet(content)
    child = os.fork()
    if child == 0:
        os._exit(0 if parquet._decoder.run(content) is None else 1)
    assert os.waitpid(child, 0)[1] == 0
    assert Parquet(content).read().equals(FRAME)


def test_no_process_is_kept_after_a_large_file(content, monkeypatch):
    monkeypatch.setattr(parquet, "KEPT_BELOW", len(content) - 1)
    assert Parquet(content).read().equals(FRAME)
    assert parquet._decoder._process is None


def test_an_empty_file_is_refused():
    with pytest.raises(SchemaError):
        Parquet(b"")
