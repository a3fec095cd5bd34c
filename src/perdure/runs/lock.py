"""Advisory file locks, which the kernel releases when their process dies."""

from __future__ import annotations

import errno
import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from perdure.runs.errors import StoreError


def acquire(path: Path, wait: bool = False) -> int | None:
    """Lock the file at `path`; create it if it does not exist.

    Args:
        path: The lock file. Its folder must exist.
        wait: Wait for another holder instead of giving up.

    Returns:
        An open file descriptor that holds the lock until `release`, or None when somebody else holds it.
    """
    while True:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            lock_file(descriptor, path, wait)
        except BlockingIOError:
            os.close(descriptor)
            return None
        except BaseException:
            os.close(descriptor)
            raise
        if is_still_at(descriptor, path):
            return descriptor
        # Between open and flock the former holder removed the file: what we locked is no longer at this path.
        os.close(descriptor)


def lock_file(descriptor: int, path: Path, wait: bool, shared: bool = False) -> None:
    """Lock an open file, which lies at `path`.

    Raises:
        BlockingIOError: Another process has locked it, and `wait` is False.
        StoreError: Its file system has no locks.
    """
    kind = fcntl.LOCK_SH if shared else fcntl.LOCK_EX
    try:
        fcntl.flock(descriptor, kind if wait else kind | fcntl.LOCK_NB)
    except OSError as error:
        if error.errno in (errno.ENOSYS, errno.ENOTSUP, errno.ENOLCK):
            raise StoreError(f"{path.parent} is on a file system without file locks (flock); choose another") from error
        raise


def is_locked(path: Path) -> bool:
    """Return whether a process holds the lock at `path`; needs no permission to write, and removes nothing."""
    try:
        descriptor = os.open(path, os.O_RDONLY)
    except FileNotFoundError:
        return False
    try:
        lock_file(descriptor, path, wait=False, shared=True)
    except BlockingIOError:
        return True
    finally:
        os.close(descriptor)
    return False


def is_still_at(descriptor: int, path: Path) -> bool:
    """Return whether the open file `descriptor` is the one that now lies at `path`."""
    try:
        there = os.stat(path)
    except FileNotFoundError:
        return False
    return os.path.samestat(os.fstat(descriptor), there)


def release(descriptor: int, path: Path) -> None:
    """Remove the lock file, then release the lock, so that no process locks a deleted file."""
    path.unlink(missing_ok=True)
    os.close(descriptor)


@contextmanager
def held(path: Path) -> Iterator[None]:
    """Hold the lock at `path` for the duration of a block; wait for it if needed."""
    descriptor = acquire(path, wait=True)
    assert descriptor is not None
    try:
        yield
    finally:
        release(descriptor, path)
