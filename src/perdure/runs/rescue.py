"""Save a finished result to a temporary folder if its disk is full."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

from perdure.runs.errors import StoreError
from perdure.runs.whole import write_whole


def write_result(path: Path, data: bytes) -> Path:
    """Write a result atomically; if that fails, save it to a new temporary folder.

    Raises:
        StoreError: The result is in the temporary folder; the message names it and how to continue.
        OSError: It could not be written to the temporary folder either.
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
