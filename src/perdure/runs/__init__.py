"""Resumable units of work with a key and a config: run once each, on this machine or on a cluster.

| file | what it holds |
|---|---|
| `store.py` | `Store`: one folder per finished unit, written atomically; `Unit`, and `attempt` to run one |
| `run.py` | `run_missing`: run a graph of units on workers; status, failures |
| `workers.py` | worker processes on this machine, bound to idle cores; tasks on a Ray cluster |
| `identity.py` | the SHA-256 of a config, a unit's record, versions of packages |
| `files.py` | `write_atomic`: replace a file atomically; `read_bounded`: regular files only; locks |
| `progress.py` | show progress: a bar in a terminal, a line every half minute elsewhere |
"""

from perdure.runs.files import open_regular, read_bounded, refuse_replacing, write_atomic, write_result
from perdure.runs.identity import config_digest, file_digest, versions
from perdure.runs.run import Observer, State, Status, UnitProgress, read_unit_progress, run_missing
from perdure.runs.store import Store, Unit, Work, attempt
from perdure.runs.workers import ONE_THREAD, LocalWorkers, Workers, check_on, core_count, make_workers

__all__ = [
    "ONE_THREAD",
    "LocalWorkers",
    "Observer",
    "State",
    "Status",
    "Store",
    "Unit",
    "UnitProgress",
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
    "write_result",
]
