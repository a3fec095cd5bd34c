"""Work spread over processes of its own that end together with this one."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from contextlib import contextmanager
from multiprocessing import get_context
from threading import Thread
from typing import Any, TypeVar

from perdure.processes import ONE_THREAD

Job = TypeVar("Job")
Told = Callable[[int], None]

_POLL = 0.1
"""Seconds between two looks at what the processes tell."""


def work_through(work: Callable[[Job, Told], None], jobs: Sequence[Job], processes: int, told: Told) -> None:
    """Does all jobs.

    The processes are new ones (a forked one would take over this one's threads in whatever state they are), do linear
    algebra on one thread, end silently at Ctrl-C, and within a second when this one is killed.

    Args:
        work: Called with one job and with whom to tell how much of it is done; a function at the top of a module, so
            that another process finds it.
        jobs: What is handed to it; must be picklable.
        processes: How many work side by side; with 1, or a single job, this process works alone.
        told: Called in this process with what the others tell.
    """
    if processes < 2 or len(jobs) < 2:
        for job in jobs:
            work(job, told)
        return
    count, spawn = min(processes, len(jobs)), get_context("spawn")
    news = spawn.SimpleQueue()
    with _one_thread_each(), ProcessPoolExecutor(count, spawn, _begin, (os.getpid(), news)) as pool:
        running = {pool.submit(_elsewhere, work, job) for job in jobs}
        try:
            while running:
                done, running = wait(running, _POLL, FIRST_COMPLETED)
                while not news.empty():
                    told(news.get())
                for finished in done:
                    finished.result()
        finally:
            pool.shutdown(cancel_futures=True)


_news: Any = None
"""In a process that works: where it tells how far it is."""


def _elsewhere(work: Callable[[Job, Told], None], job: Job) -> None:
    work(job, _news.put)


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """Processes begun meanwhile use one thread each: together they have the cores already."""
    before = {name: os.environ.get(name) for name in ONE_THREAD}
    os.environ.update(ONE_THREAD)
    try:
        yield
    finally:
        for name, value in before.items():
            os.environ.pop(name) if value is None else os.environ.update({name: value})


def _begin(parent: int, news: Any) -> None:
    """In a new process: ends it when its parent is gone, however that ended."""
    global _news
    _news = news
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # Python's own handler would print where it was

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(0.5)
        os._exit(1)

    Thread(target=watch, daemon=True).start()
