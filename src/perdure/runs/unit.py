"""A unit of work: a key, a config and a function. The result does not depend on who runs it or where."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any, Literal

from perdure.runs.errors import StoreError, UnitBusyError
from perdure.runs.store import Store
from perdure.schema import Real, SchemaError, Table, read_json

ReportCallback = Callable[..., None]
"""Called as ``report(done, total, **facts)``: work done and total work, in any unit; further numbers to show."""

AttemptResult = Literal["finished", "unfinished", "busy"]

PROGRESS = Table(
    {
        "done": Real(0.0),
        "total": Real(0.0),
        "facts": Table({}, others=Real(infinite=True, unknown=True)),
    }
)
"""A report on disk."""
REPORT_SECONDS = 0.5
"""Reports are written to disk this often at most."""


@dataclass(frozen=True)
class Unit:
    """A unit of work as plain data, so that any process can run it."""

    key: str
    """Readable identity and place in the store, such as "Hopper-v3/geometric/seed-0"."""
    config: Mapping[str, Any]
    """Everything the result depends on; JSON. A finished unit of the same key and config is never run again."""
    function: str
    """``"package.module:name"`` of a function (`Work`, **arguments) -> bool | None. It leaves its result in the work
    folder. To be stopped and resumed it returns False whenever it has saved a checkpoint there: it is called again."""
    arguments: Mapping[str, Any] = field(default_factory=dict)
    """Keyword arguments of the function; JSON. No result depends on what is not in the config too."""
    after: tuple[str, ...] = ()
    """Keys of units that must be finished before this one begins."""
    size: float = 1.0
    """Amount of work relative to other units, for progress and remaining time."""
    cores: int = 1
    """Cores it can use."""

    def to_json(self) -> dict[str, Any]:
        """Return the unit as plain JSON values."""
        return asdict(self)

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> Unit:
        """Return the unit that `to_json` described."""
        return cls(**{**values, "after": tuple(values["after"])})


@dataclass(frozen=True)
class Work:
    """The argument of a unit's function."""

    folder: Path
    """Folder for its result; an interrupted attempt may have left files there."""
    threads: int
    """Cores it may use. No result may depend on it."""
    report: ReportCallback


def attempt(root: str | Path, unit: Unit, threads: int = 1, report: ReportCallback | None = None) -> AttemptResult:
    """Run a unit in this process, up to its end or its next checkpoint.

    Args:
        root: Folder of the store.
        unit: The unit; nothing happens if it is finished.
        threads: Cores it may use.
        report: Called with every report; by default reports go to a file that `read_progress` reads.

    Returns:
        "finished", "unfinished" (to be called again), or "busy": another process is running it.

    Raises:
        StoreError: The unit cannot be stored.
        Exception: Whatever the unit's function raises.
    """
    store = Store(root)
    if store.done(unit.key, unit.config):
        return "finished"
    module, _, name = unit.function.partition(":")
    function = getattr(import_module(module), name)
    try:
        with store.workspace(unit.key, unit.config) as workspace:
            shown = report or _Reporter(store, unit.key)
            workspace.complete = function(Work(workspace.folder, threads, shown), **unit.arguments) is not False
    except UnitBusyError:
        return "busy"
    except StoreError:
        if store.done(unit.key, unit.config):  # another process finished it in the meantime
            return "finished"
        raise
    return "finished" if workspace.complete else "unfinished"


class _Reporter:
    """Writes reports to the store, where any process can read them."""

    def __init__(self, store: Store, key: str) -> None:
        self._path = store.note_path("progress", key)
        self._last = 0.0

    def __call__(self, done: float, total: float, **facts: float) -> None:
        now = time.monotonic()
        if now - self._last < REPORT_SECONDS and done < total:
            return
        self._last = now
        temporary = self._path.with_suffix(f".{os.getpid()}")
        with suppress(OSError):  # progress is not worth failing for
            self._path.parent.mkdir(parents=True, exist_ok=True)
            temporary.write_text(json.dumps({"done": done, "total": total, "facts": facts}))
            os.replace(temporary, self._path)


def read_progress(store: Store, key: str) -> tuple[float, float, dict[str, float]]:
    """Return (done, total, facts) of the unit's last report, (0, 1, {}) before the first."""
    with suppress(OSError, SchemaError):
        record = read_json(store.note_path("progress", key).read_bytes())
        PROGRESS.check(record)
        return float(record["done"]), float(record["total"]), dict(record["facts"])
    return 0.0, 1.0, {}
