"""Several worker processes that share out a list of jobs."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import ExitStack
from typing import Any

from perdure.processes.cores import own_cores
from perdure.processes.worker import WorkerProcess


def share_out(module: str, jobs: Sequence[Any], processes: int, told: Callable[[int, Any], None]) -> None:
    """Does all jobs, in their order, each by whichever process is free.

    A process has a core of its own where there is one that nobody uses. All of them end with this call.

    Args:
        module: What they run, see `perdure.processes.WorkerProcess`.
        jobs: What is handed to them; JSON.
        processes: How many work side by side; no more than there are jobs.
        told: Called with a job's place in the list and with what is told about it, by one thread at a time.

    Raises:
        WorkerError: If a process failed; the others are ended.
    """
    waiting: queue.SimpleQueue[int] = queue.SimpleQueue()
    for number in range(len(jobs)):
        waiting.put(number)
    lock, count = threading.Lock(), min(processes, len(jobs))

    def work(worker: WorkerProcess) -> None:
        while True:
            try:
                number = waiting.get_nowait()
            except queue.Empty:
                return
            for news in worker.ask(jobs[number]):
                with lock:
                    told(number, news)

    with own_cores(count) as free, ExitStack() as stack:
        places = [free[place : place + 1] for place in range(count)]
        workers = [stack.enter_context(WorkerProcess(module, cores)) for cores in places]
        pool = stack.enter_context(ThreadPoolExecutor(max(count, 1)))
        try:
            for done in as_completed([pool.submit(work, worker) for worker in workers]):
                done.result()
        except BaseException:
            for worker in workers:
                worker.kill()
            raise
