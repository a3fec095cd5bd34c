"""Which cores a process may take for itself.

A loop that hands over to another thread at every step, as EnvPool's do, is much faster when both threads share a core
than when each wakes the other on a second one. So workers are bound to cores, and to such as nobody else is using.
"""

from __future__ import annotations

import os
import time
from pathlib import Path

STAT = Path("/proc/stat")
LOOK = 0.2
"""Seconds for which the cores are watched."""
BUSY = 0.5
"""A core that worked for more than this share of that time is somebody else's."""


def idle_cores(stat: Path = STAT) -> list[int]:
    """Cores this process may run on and nobody is using, those with least to do first.

    Empty where the system does not say what its cores do.
    """
    try:
        before = _times(stat)
        time.sleep(LOOK)
        after = _times(stat)
        allowed = os.sched_getaffinity(0)
    except (OSError, ValueError, AttributeError):
        return []
    load = {}
    for core in allowed & before.keys() & after.keys():
        worked, passed = (after[core][k] - before[core][k] for k in range(2))
        load[core] = worked / passed if passed > 0 else 0.0
    return sorted((core for core, share in load.items() if share < BUSY), key=lambda core: (load[core], core))


def _times(stat: Path) -> dict[int, tuple[int, int]]:
    """For each core the ticks it worked and the ticks that passed, since the system began (proc(5))."""
    times = {}
    for line in stat.read_text().splitlines():
        name, *ticks = line.split()
        if name.startswith("cpu") and name != "cpu":
            counts = [int(tick) for tick in ticks[:8]]
            idle = counts[3] + counts[4]  # idle, and waiting for a disk
            times[int(name[3:])] = sum(counts) - idle, sum(counts)
    return times
