"""Work spread over processes of its own that end together with this one."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from multiprocessing import get_context
from threading import Thread
from typing import TypeVar

Job = TypeVar("Job")
Result = TypeVar("Result")

_LIBRARIES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def work_through(work: Callable[[Job], Result], jobs: Sequence[Job], processes: int) -> Iterator[Result]:
    """Results of all jobs, each as soon as it is there.

    The processes are new ones (a forked one would take over this one's threads in whatever state they are), do linear
    algebra on one thread, end silently at Ctrl-C, and within a second when this one is killed.

    Args:
        work: Called with one job; a function at the top of a module, so that another process finds it.
        jobs: What is handed to it; must be picklable.
        processes: How many work side by side; with 1, or a single job, this process works alone.
    """
    if processes < 2 or len(jobs) < 2:
        yield from map(work, jobs)
        return
    count = min(processes, len(jobs))
    with (
        _one_thread_each(),
        ProcessPoolExecutor(count, get_context("spawn"), _end_with, (os.getpid(),)) as pool,
    ):
        running = [pool.submit(work, job) for job in jobs]
        try:
            for finished in as_completed(running):
                yield finished.result()
        finally:
            pool.shutdown(cancel_futures=True)


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """Processes begun meanwhile use one thread each: together they have the cores already."""
    before = {name: os.environ.get(name) for name in _LIBRARIES}
    os.environ.update(dict.fromkeys(_LIBRARIES, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            os.environ.pop(name) if value is None else os.environ.update({name: value})


def _end_with(parent: int) -> None:
    """In a new process: ends it when its parent is gone, however that ended."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # Python's own handler would print where it was

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(0.5)
        os._exit(1)

    Thread(target=watch, daemon=True).start()
