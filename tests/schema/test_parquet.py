"""Damaged Parquet is refused, even if Polars aborts its process over it."""

import io
import os

import polars as pl
import pytest

from perdure.schema import SchemaError, parquet, read_columns, read_notes, read_parquet

FRAME = pl.DataFrame({"a": [1, None, 3], "b": [None, "x", "y"], "c": [[1.0], [], None]})


@pytest.fixture(scope="module")
def content():
    buffer = io.BytesIO()
    FRAME.write_parquet(buffer, metadata={"note": "text"})
    return buffer.getvalue()


def test_what_is_read_is_what_polars_reads(content):
    assert read_parquet(content).equals(FRAME)
    assert read_parquet(content, ["b"]).equals(FRAME.select("b"))
    assert read_columns(content) == dict(FRAME.schema)
    assert read_notes(content) == {"note": "text"}


def test_every_single_byte_may_be_damaged(content):
    buffer, ends = io.BytesIO(), set()
    pl.DataFrame({"a": [None if k % 7 == 0 else k for k in range(60)]}).write_parquet(buffer)
    for at in range(len(buffer.getvalue())):
        changed = bytearray(buffer.getvalue())
        changed[at] = 127
        try:
            read_parquet(bytes(changed))
        except SchemaError as error:
            ends.add("aborted" if "gave up its process" in str(error) else "refused")
        else:
            ends.add("read")
    assert ends == {"read", "refused", "aborted"}
    assert read_parquet(content).equals(FRAME)


def test_a_decoder_that_was_killed_is_started_again(content):
    read_parquet(content)
    parquet._decoder._process.kill()
    parquet._decoder._process.wait()
    assert read_parquet(content).equals(FRAME)


def test_a_forked_process_has_a_decoder_of_its_own(content):
    read_parquet(content)
    child = os.fork()
    if child == 0:
        os._exit(0 if read_notes(content) == {"note": "text"} else 1)  # Polars itself does not survive a fork
    assert os.waitpid(child, 0)[1] == 0
    assert read_parquet(content).equals(FRAME)


def test_a_missing_column_is_named(content):
    with pytest.raises(SchemaError, match="nothing"):
        read_parquet(content, ["nothing"])
