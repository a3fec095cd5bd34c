"""Results of long work on a disk that stops taking them: they are kept elsewhere instead of being lost."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

from perdure.runs.errors import StoreError
from perdure.runs.whole import write_whole


def write_result(path: Path, data: bytes) -> Path:
    """Write a result whole, as `write_whole` does; if its disk takes nothing, into a new temporary folder.

    Raises:
        StoreError: The result lies in the temporary folder; the message says where, and how to go on.
        OSError: It could be written nowhere.
    """
    try:
        return write_whole(path, data)
    except OSError as error:
        try:
            kept = write_whole(Path(tempfile.mkdtemp(prefix="perdure-kept-"), path.name), data)
        except OSError:
            raise error from None
        raise StoreError(
            f"{os.fspath(path)}: {error.strerror}; the finished result is kept in {kept}: make the disk writable, "
            f"copy it to {os.fspath(path)} and run the same command"
        ) from error
