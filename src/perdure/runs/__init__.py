"""Resumable units of work with a key and a config: run once each, on this machine or on a cluster."""

from perdure.runs.files import open_regular, read_bounded, refuse_replacing, write_atomic
from perdure.runs.identity import config_digest, file_digest, versions
from perdure.runs.run import Observer, Status, UnitProgress, UnitState, read_unit_progress, run_missing
from perdure.runs.store import Store, Unit, Work, attempt
from perdure.runs.workers import ONE_THREAD, LocalWorkers, Workers, check_on, core_count, make_workers

__all__ = [
    "ONE_THREAD",
    "LocalWorkers",
    "Observer",
    "Status",
    "Store",
    "Unit",
    "UnitProgress",
    "UnitState",
    "Work",
    "Workers",
    "attempt",
    "check_on",
    "config_digest",
    "core_count",
    "file_digest",
    "make_workers",
    "open_regular",
    "read_bounded",
    "read_unit_progress",
    "refuse_replacing",
    "run_missing",
    "versions",
    "write_atomic",
]
