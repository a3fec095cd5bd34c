"""Files that are replaced atomically, and advisory locks, which the kernel releases when their process dies.

Readers see the old or the new file, also after a crash or on a full disk.
"""

from __future__ import annotations

import errno
import fcntl
import io
import os
import secrets
import socket
import stat
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from perdure.errors import PerdureError


def write_atomic(path: str | os.PathLike[str], data: bytes | str) -> Path:
    """Write `data` to `path` through a temporary file in the same folder, fsync and rename.

    Missing folders are made. A symbolic link at `path` stays, its target is replaced. The permissions of the old file
    stay. What a killed writer left in the folder is removed.

    Args:
        path: Where the file shall be.
        data: Bytes, or text that is encoded as UTF-8 without changing line ends.

    Returns:
        `path` as a `Path`.

    Raises:
        OSError: The disk is full, the folder cannot be written, `path` is a device, ...; it names `path`, and the old
            file is untouched.
    """
    target = Path(os.path.realpath(path))
    if isinstance(data, str):
        data = data.encode()
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        mode = _mode(target)
        prefix = f".partial-{socket.gethostname()}~"
        for leftover in target.parent.glob(f"{prefix}*"):
            _remove_if_dead(leftover, int(leftover.name.removeprefix(prefix).partition("-")[0]))
        temporary = target.with_name(f"{prefix}{os.getpid()}-{secrets.token_hex(6)}")
        try:
            with open(temporary, "xb") as file:
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
            if mode is not None:
                temporary.chmod(mode)
            os.replace(temporary, target)
        except BaseException:
            temporary.unlink(missing_ok=True)
            raise
        sync(target.parent)
    except OSError as error:
        raise type(error)(error.errno, error.strerror, os.fspath(path)) from error
    return Path(path)


def read_bounded(path: str | os.PathLike[str], most: int) -> bytes:
    """Return the contents of a regular file of at most `most` bytes; PerdureError for others.

    A FIFO does not block, and a device is not read.
    """
    with open_regular(path) as file:
        size = os.fstat(file.fileno()).st_size
        if size > most:
            raise PerdureError(f"{os.fspath(path)} has {size:,} bytes; at most {most:,} are read")
        return file.read()


def open_regular(path: str | os.PathLike[str]) -> io.FileIO:
    """Return a regular file, open for reading; PerdureError if it is a FIFO or a device."""
    file = io.FileIO(path, opener=lambda name, flags: os.open(name, flags | os.O_NONBLOCK))
    if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
        file.close()
        raise PerdureError(f"{os.fspath(path)} is not a regular file")
    return file


def refuse_replacing(path: str | os.PathLike[str]) -> None:
    """Raise PerdureError if there is a file: no command replaces a finished one."""
    if os.path.lexists(path):
        raise PerdureError(f"{os.fspath(path)} exists and would be replaced: name another file, or remove it")


def sync(path: Path) -> None:
    """Make the content of a file, or the names inside a folder, durable (POSIX: fsync)."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _mode(target: Path) -> int | None:
    """Return the permissions of the file at `target`; None if there is none."""
    try:
        mode = target.stat().st_mode
    except FileNotFoundError:
        return None
    if stat.S_ISREG(mode):
        return stat.S_IMODE(mode)
    if stat.S_ISDIR(mode):  # the rename fails with its own error
        return None
    raise OSError(errno.EINVAL, "is not a regular file", target)


def _remove_if_dead(leftover: Path, writer: int) -> None:
    """Remove a temporary file whose process has ended."""
    try:
        os.kill(writer, 0)
    except ProcessLookupError:
        leftover.unlink(missing_ok=True)
    except PermissionError:  # another user's process
        pass


# Locks


@contextmanager
def held(path: Path, waiting: Callable[[], None] = lambda: None) -> Iterator[None]:
    """Hold the lock at `path` for the duration of a block; if another process holds it, call `waiting` and wait."""
    descriptor = acquire(path)
    if descriptor is None:
        waiting()
        descriptor = acquire(path, wait=True)
    assert descriptor is not None
    try:
        yield
    finally:
        release(descriptor)


def release(descriptor: int) -> None:
    """Give up a lock that `acquire` returned, also where a forked process has inherited the open file."""
    fcntl.flock(descriptor, fcntl.LOCK_UN)
    os.close(descriptor)


def acquire(path: Path, wait: bool = False) -> int | None:
    """Lock the file at `path`; create it if it does not exist. It stays: a new one would be another lock.

    Args:
        path: The lock file. Its folder must exist.
        wait: Wait for another holder instead of giving up.

    Returns:
        An open file descriptor, which holds the lock until it is closed, or None when somebody else holds it.

    Raises:
        PerdureError: Its file system has no locks.
    """
    operation = fcntl.LOCK_EX
    if not wait:
        operation |= fcntl.LOCK_NB
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
    try:
        fcntl.flock(descriptor, operation)
    except BlockingIOError:
        os.close(descriptor)
        return None
    except BaseException as error:
        os.close(descriptor)
        if isinstance(error, OSError) and error.errno in (errno.ENOSYS, errno.ENOTSUP, errno.ENOLCK):
            text = f"{path.parent} is on a file system without file locks (flock); choose another"
            raise PerdureError(text) from error
        raise
    return descriptor
