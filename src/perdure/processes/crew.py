"""Several worker processes at work side by side."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import ExitStack
from typing import Any

from perdure.processes.cores import own_cores
from perdure.processes.worker import WorkerProcess


def share_out(module: str, jobs: Sequence[Any], processes: int, told: Callable[[int, Any], None]) -> None:
    """Does all jobs, in their order, each by whichever process is free.

    Args:
        module: What they run, see `perdure.processes.WorkerProcess`.
        jobs: What is handed to them; JSON.
        processes: How many work side by side; no more than there are jobs.
        told: Called with a job's place in the list and with what is told about it, by one thread at a time.

    Raises:
        WorkerError: As for `side_by_side`.
    """
    waiting, lock = iter(range(len(jobs))), threading.Lock()

    def work(worker: WorkerProcess) -> None:
        while True:
            with lock:
                number = next(waiting, None)
            if number is None:
                return
            for news in worker.ask(jobs[number]):
                with lock:
                    told(number, news)

    side_by_side(module, min(processes, len(jobs)), work)


def side_by_side(module: str, processes: int, work: Callable[[WorkerProcess], None], cores: int = 1) -> None:
    """Starts processes and has each asked for work by a thread of its own; all of them end with this call.

    A process is bound to cores that nobody uses, where there are enough of them.

    Args:
        module: What they run, see `perdure.processes.WorkerProcess`.
        processes: How many; with 0 nothing happens.
        work: Called with a process, by all threads at once.
        cores: How many each of them needs.

    Raises:
        WorkerError: If a process failed; the others are ended. Whatever else `work` raises reaches the caller, too.
    """
    with own_cores(processes * cores) as free, ExitStack() as stack:
        workers = []
        for place in range(processes):
            mine = free[place * cores : (place + 1) * cores]
            workers.append(stack.enter_context(WorkerProcess(module, mine if len(mine) == cores else ())))
        pool = stack.enter_context(ThreadPoolExecutor(max(processes, 1)))
        try:
            for done in as_completed([pool.submit(work, worker) for worker in workers]):
                done.result()
        except BaseException:
            for worker in workers:
                worker.kill()
            raise
