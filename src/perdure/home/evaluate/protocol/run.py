"""The benchmark's protocol: episodes x training seeds x evaluation seeds for one task and one arm, resumable."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from perdure.home.evaluate.protocol.job import LOGS, Job, parts
from perdure.home.evaluate.protocol.protocol import Protocol
from perdure.runs import Observer, Store, core_count, make_workers, run_units


def run_protocol(
    protocol: Protocol,
    out: str | Path,
    *,
    cores: int | None = None,
    on: str = "here",
    command: str = "",
    observe: Observer = lambda status: None,
) -> list[Path]:
    """Run what is missing of a protocol and return the logs of all of it.

    Args:
        protocol: What to run.
        out: Folder of the store. The same call resumes an interrupted one.
        cores: Cores to use; all by default. No result depends on it.
        on: Where to run, see `perdure.runs.make_workers`.
        command: What asked for it; noted in the logs that are written now.
        observe: Called with the progress of every part; the measure is episodes.

    Raises:
        HomeError: If a policy is missing, before anything is run.
        RunError: If a part failed.
    """
    store, jobs = Store(out), list(_jobs(protocol, command))
    store.warn_of_other_source(job.key for job in jobs)
    missing = [job.unit for job in jobs if not store.done(job.key, job.config)]
    if missing:
        run_units(missing, out, make_workers(on, missing, cores), observe, threads=core_count(cores))
    return [store.get(job.key, job.config) / LOGS for job in jobs]


def _jobs(protocol: Protocol, command: str) -> Iterator[Job]:
    """All parts; each training seed's policies are read once."""
    policies = {seed: protocol.assignment(seed) for seed in range(protocol.train_seeds)}
    for part in parts(protocol):
        yield Job(protocol, part, policies[part.train_seed], command)
