"""Find and reserve idle cores.

A loop that hands over to another thread at every step, as EnvPool's do, is much faster when both threads share a core
than when each wakes the other on a second one. So workers are bound to cores, and to such as nobody else is using.
"""

from __future__ import annotations

import fcntl
import os
import stat
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

STAT = Path("/proc/stat")
LOOK = 0.2
"""Seconds for which core usage is measured."""
BUSY = 0.5
"""A core that was busy for more than this share of that time is in use."""


@contextmanager
def own_cores(count: int) -> Iterator[list[int]]:
    """Reserve at most ``count`` idle cores that no other perdure process has reserved, for the duration of a block.

    Otherwise two commands that start at the same time would choose the same cores.
    """
    with ExitStack() as stack:
        taken: list[int] = []
        for core in idle_cores() if count else ():
            if len(taken) < count and (lock := _lock(core)) is not None:
                stack.callback(os.close, lock)
                taken.append(core)
        yield taken


def _lock(core: int) -> int | None:
    """Return an open file that holds the core, or None. The kernel releases it when the process dies."""
    folder = Path(tempfile.gettempdir(), f"perdure-{os.getuid()}")
    try:
        folder.mkdir(mode=0o700, exist_ok=True)
        owner = folder.lstat()
        if not stat.S_ISDIR(owner.st_mode) or owner.st_uid != os.getuid():
            return None  # another user's: without locks two commands may choose the same core, which is only slower
        flags = os.O_RDONLY | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
        lock = os.open(folder / f"core-{core}.lock", flags, 0o600)
    except OSError:
        return None
    try:
        if not stat.S_ISREG(os.fstat(lock).st_mode):
            raise OSError
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(lock)
        return None
    return lock


def idle_cores(counters: Path = STAT) -> list[int]:
    """Return idle cores that this process may run on, least busy first.

    Empty where the system does not say what its cores do.
    """
    try:
        before = _times(counters)
        time.sleep(LOOK)
        after = _times(counters)
        allowed = os.sched_getaffinity(0)
    except (OSError, ValueError, AttributeError):
        return []
    load = {}
    for core in allowed & before.keys() & after.keys():
        worked, passed = (after[core][k] - before[core][k] for k in range(2))
        if passed > 0:  # else the system does not say
            load[core] = worked / passed
    return sorted((core for core, share in load.items() if share < BUSY), key=lambda core: (load[core], core))


def _times(counters: Path) -> dict[int, tuple[int, int]]:
    """Return each core's busy ticks and all ticks since boot (proc(5))."""
    times = {}
    for line in counters.read_text().splitlines():
        name, *ticks = line.split()
        if name.startswith("cpu") and name != "cpu":
            counts = [int(tick) for tick in ticks[:8]]
            idle = counts[3] + counts[4]  # idle, and waiting for a disk
            times[int(name[3:])] = sum(counts) - idle, sum(counts)
    return times
