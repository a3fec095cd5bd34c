"""Resumable units of work with a key and a config: run once each, on this machine or on a cluster.

| file | what it holds |
|---|---|
| `unit.py` | `Unit`: key, config, function; `attempt`: run one to its end or its next checkpoint |
| `run.py` | `run_units`: run a graph of units on workers; status, failures |
| `workers.py`, `on_ray.py` | worker processes on this machine; tasks on a Ray cluster |
| `cores.py` | which cores are free |
| `progress.py` | show progress: a bar in a terminal, a line every half minute elsewhere |
| `store.py` | `Store`: one folder per finished unit, written atomically |
| `identity.py` | the SHA-256 of a config, and a unit's record |
| `source.py` | digest of the source code that made a unit |
| `atomic_write.py` | `write_atomic`: replace a file atomically; `write_result`: save elsewhere if that fails |
| `lock.py` | advisory locks that the kernel releases when a process dies |
| `errors.py` | `StoreError`, `UnitBusyError`, `RunError`, `OtherSourceWarning` |

The only other part of perdure that this package imports is `schema`.
"""

from perdure.runs.atomic_write import write_atomic, write_result
from perdure.runs.errors import OtherSourceWarning, RunError, StoreError, UnitBusyError
from perdure.runs.identity import config_digest, file_digest
from perdure.runs.run import Observer, State, Status, UnitProgress, read_unit_progress, run_missing, run_units
from perdure.runs.store import Store
from perdure.runs.unit import Unit, Work, attempt
from perdure.runs.workers import ONE_THREAD, LocalWorkers, Workers, check_on, core_count, make_workers

__all__ = [
    "ONE_THREAD",
    "LocalWorkers",
    "Observer",
    "OtherSourceWarning",
    "RunError",
    "State",
    "Status",
    "Store",
    "StoreError",
    "Unit",
    "UnitBusyError",
    "UnitProgress",
    "Work",
    "Workers",
    "attempt",
    "check_on",
    "config_digest",
    "core_count",
    "file_digest",
    "make_workers",
    "read_unit_progress",
    "run_missing",
    "run_units",
    "write_atomic",
    "write_result",
]
