"""Seeds spread over processes: each carries the seed that is furthest behind on by a segment, then takes the next.

So the seeds stay together, and five of them keep two cores busy to the end.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from pathlib import Path

from perdure.ppo.chain import reached
from perdure.ppo.config import PPOConfig
from perdure.processes import WorkerProcess, side_by_side

WORKER = "perdure.ppo.worker"

Told = Callable[[int, int, float], None]
"""Called with (seed, its steps so far, mean return of its last episodes), by one thread at a time."""


def carry_all(
    task: str, config: PPOConfig, folders: Mapping[int, Path], processes: int, threads: int, told: Told
) -> None:
    """Carries every seed to its end.

    Args:
        task: What they are trained on.
        config: How.
        folders: Where the checkpoint of each seed lies.
        processes: How many work side by side, each on cores of its own; no more than threads and seeds.
        threads: Cores for all of them together.
        told: Who hears of it.

    Raises:
        WorkerError: If a process failed; the others are ended, and nothing that they had finished is lost.
    """
    waiting = {seed: reached(folder) for seed, folder in folders.items()}
    waiting = {seed: segment for seed, segment in waiting.items() if segment < config.segments}
    processes = min(processes, threads, len(waiting))
    # One environment is stepped by one thread: more cores for a process would only be woken and put to sleep.
    each = min(threads // max(processes, 1), config.n_envs)
    settings, lock = config.to_json(), threading.Lock()

    def work(worker: WorkerProcess) -> None:
        while True:
            with lock:
                if not waiting:
                    return
                seed = min(waiting, key=lambda seed: (waiting[seed], seed))
                segment = waiting.pop(seed)
            job = {"task": task, "config": settings, "threads": each, "seed": seed, "folder": str(folders[seed])}
            for step, mean_return in worker.ask(job):
                with lock:
                    told(seed, step, mean_return)
            if segment + 1 < config.segments:
                with lock:
                    waiting[seed] = segment + 1

    side_by_side(WORKER, processes, work, each)
