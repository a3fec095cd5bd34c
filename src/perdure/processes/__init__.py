"""Work in processes of our own: for each core one, with single-threaded arithmetic, that end together with this one.

    worker.py   a module that runs as a process, takes jobs and answers (WorkerProcess, serve)
    crew.py     several of them, and a list of jobs that they share out (side_by_side, share_out)
    cores.py    which cores are free for it (own_cores, idle_cores)

The package imports nothing else of perdure.
"""

from perdure.processes.cores import idle_cores, own_cores
from perdure.processes.crew import share_out, side_by_side
from perdure.processes.worker import ONE_THREAD, WorkerError, WorkerProcess, serve

__all__ = [
    "ONE_THREAD",
    "WorkerError",
    "WorkerProcess",
    "idle_cores",
    "own_cores",
    "serve",
    "share_out",
    "side_by_side",
]
