"""A finished result outlives a disk that takes nothing any more."""

import errno
import os
import re
import tempfile

import pytest

from perdure.errors import PerdureError
from perdure.runs import write_result


@pytest.fixture
def broken(tmp_path, monkeypatch):
    """A folder on a disk that has become read-only; temporary files go elsewhere."""
    disk, spare = tmp_path / "disk", tmp_path / "spare"
    disk.mkdir()
    spare.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(spare))

    def refuse(path, mode):
        if str(path).startswith(str(disk)):
            raise OSError(errno.EROFS, os.strerror(errno.EROFS), path)
        return open(path, mode)

    monkeypatch.setattr("perdure.runs.files.open", refuse, raising=False)
    return disk


def test_a_result_is_kept_elsewhere_and_the_message_says_where(broken):
    with pytest.raises(PerdureError, match="Read-only file system; the finished result is kept in") as error:
        write_result(broken / "logs.parquet", b"result")
    (kept,) = re.findall(r"kept in (\S+):", str(error.value))
    with open(kept, "rb") as file:
        assert file.read() == b"result"


def test_where_nothing_can_be_written_the_first_error_is_told(broken, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(broken))
    monkeypatch.setattr(tempfile, "mkdtemp", lambda prefix: str(broken / "none"))
    with pytest.raises(OSError, match="Read-only file system") as error:
        write_result(broken / "logs.parquet", b"result")
    assert error.value.filename.endswith("logs.parquet")


def test_on_a_disk_that_works_it_is_a_plain_file(tmp_path):
    assert write_result(tmp_path / "a", b"result").read_bytes() == b"result"
