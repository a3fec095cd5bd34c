"""The benchmark's protocol: episodes x training seeds x evaluation seeds for one task and one arm, resumable."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from perdure.home.errors import HomeError
from perdure.home.evaluate.protocol.job import LOGS, Job, Told, units
from perdure.home.evaluate.protocol.protocol import Protocol
from perdure.processes import WorkerError, share_out
from perdure.store import Store

WORKER = "perdure.home.evaluate.protocol.worker"


def run_protocol(
    protocol: Protocol, out: str | Path, told: Told = lambda episodes: None, command: str = "", processes: int = 1
) -> list[Path]:
    """Runs what is missing of a protocol and hands back the logs of all of it.

    Args:
        protocol: What to run.
        out: Folder of the store. The same call goes on where a killed one stopped.
        told: Called with 1 whenever an episode has ended.
        command: What asked for it; noted in the logs that are written now.
        processes: How many work side by side, each on one core; with 1 this process alone, on the cores of
            `ExecutorOptions.threads`. No result depends on it.

    Raises:
        HomeError: If a policy is missing, before anything is run; or if a process failed.
    """
    store, jobs = Store(out), list(_jobs(protocol, out, command))
    store.warn_of_other_source(job.key for job in jobs)
    missing = [job for job in jobs if not store.done(job.key, job.config)]
    if processes > 1 and len(missing) > 1:
        try:
            share_out(WORKER, [job.on_one_core().to_json() for job in missing], processes, lambda _, more: told(more))
        except WorkerError as error:
            raise HomeError(str(error)) from None
    else:
        for job in missing:
            job.run(told)
    return [store.get(job.key, job.config) / LOGS for job in jobs]


def _jobs(protocol: Protocol, out: str | Path, command: str) -> Iterator[Job]:
    """All units; each training seed's policies are read once."""
    policies = {seed: protocol.cast(seed) for seed in range(protocol.train_seeds)}
    for unit in units(protocol):
        yield Job(protocol, unit, policies[unit.train_seed], out, command)
