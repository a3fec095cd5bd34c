"""Run a graph of units once each, in dependency order, on the available workers."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

from perdure.errors import PerdureError
from perdure.runs.files import write_atomic
from perdure.runs.store import Store, Unit, attempt, read_progress
from perdure.runs.workers import Ended, Workers, core_count, make_workers, one_line

POLL_SECONDS = 0.25
UNITS_AHEAD = 2
"""Units for each worker that take turns. More would end them more evenly, but late, and an interrupted command should
leave whole units."""
BUSY_SECONDS = 1.0
"""Interval at which units that another command is running are tried again."""

UnitState = Literal["waiting", "running", "busy", "finished", "failed", "blocked"]


@dataclass(frozen=True)
class UnitProgress:
    """Progress of one unit."""

    state: UnitState
    """"busy": another command is running it; "blocked": a unit it depends on has failed."""
    done: float = 0.0
    total: float = 1.0
    """Work done and total work, in the unit's own measure."""
    facts: Mapping[str, float] = field(default_factory=dict)
    """Further numbers that the unit reports, such as its mean return."""
    error: str = ""
    size: float = 1.0
    """Amount of work relative to other units."""

    @property
    def share(self) -> float:
        """Share of the unit that is done, from 0 to 1."""
        if self.state == "finished":
            return 1.0
        if self.total <= 0:
            return 0.0
        return min(1.0, self.done / self.total)


Status = Mapping[str, UnitProgress]
"""Key of each unit to its progress."""
Observer = Callable[[Status], None]


def run_missing(
    units: Sequence[Unit],
    root: str | Path,
    on: str = "here",
    cores: int | None = None,
    observe: Observer = lambda status: None,
    waiting: Callable[[], None] = lambda: None,
    keep_going: bool = True,
) -> None:
    """Run every unit that is not finished; start nothing if all are. The same call resumes a killed one.

    Units that another command is running are waited for. A unit that fails does not stop those that do not depend on
    it; its error is recorded in the store.

    Args:
        units: The graph. Each comes after those named in its `after`.
        root: Folder of the store.
        on: Where: see `make_workers`.
        cores: Cores to use; all by default.
        observe: Called with the status of all units, about four times a second and at every report in this process.
        waiting: Called once, before waiting for units that other commands run, unless a unit has failed. What it raises
            ends the run.
        keep_going: False: what a unit raises in this process ends the run at once.

    Raises:
        PerdureError: Units failed (raised when nothing more can be run), `on` or `cores` is out of range, a unit cannot
            be stored or was finished with another config, or two of one key differ.
    """
    store = Store(root)
    missing = [unit for unit in units if not store.done(unit.key, unit.config)]
    if not missing:
        return
    workers = make_workers(on, missing, cores)
    run = _Run(units, store, observe, waiting)
    if workers is None:
        run.run_here(core_count(cores), keep_going)
    else:
        with workers:
            run.run_on(workers)
    run.raise_failures()


def read_unit_progress(store: Store, unit: Unit) -> UnitProgress:
    """Return how far a unit is, from the store alone, so also while another process runs it.

    Raises:
        PerdureError: The finished unit has another config.
    """
    state: UnitState = "waiting"
    if store.done(unit.key, unit.config):
        state = "finished"
    done, total, facts = read_progress(store, unit.key)
    return UnitProgress(state, done, total, facts, size=unit.size)


class _Run:
    def __init__(self, units: Sequence[Unit], store: Store, observe: Observer, waiting: Callable[[], None]) -> None:
        self._store = store
        self._observe = observe
        self._waiting = waiting
        self._announced = False
        self._units = {unit.key: unit for unit in units}
        if len(self._units) < len(units):
            keys = [unit.key for unit in units]
            twice = next(key for key in keys if keys.count(key) > 1)
            raise PerdureError(f"two units have the key {twice!r}")
        for unit in units:
            for key in unit.after:
                if key not in self._units:
                    raise PerdureError(f"{unit.key!r} comes after {key!r}, which is no unit of this run")
        self._status = {unit.key: read_unit_progress(store, unit) for unit in units}
        self._try_again: dict[str, float] = {}
        self._errors: dict[str, BaseException] = {}

    def run_here(self, threads: int, keep_going: bool) -> None:
        """Run everything in this process."""
        self._observe(self._status)
        while True:
            unit = self._next(1)
            if unit is None:
                if not self._wait_for_others():
                    return
                continue
            self._set(unit.key, "running")
            try:
                result = attempt(self._store.root, unit, threads, self._reporter(unit.key))
                self._record_end(Ended(unit.key, result))
            except Exception as error:
                if not keep_going:
                    raise
                self._errors[unit.key] = error
                self._record_end(Ended(unit.key, None, one_line(error)))
            self._observe(self._status)

    def run_on(self, workers: Workers) -> None:
        """Keep workers busy until nothing more can be run."""
        while True:
            while workers.free:
                unit = self._next(workers.free + self._running())
                if unit is None:
                    break
                self._set(unit.key, "running")
                workers.start(self._store.root, unit)
            self._observe(self.refresh())
            running = self._running()
            if not running and not self._wait_for_others():
                return
            if running:
                for ended in workers.wait(POLL_SECONDS):
                    self._record_end(ended)

    def refresh(self) -> Status:
        """Return the status with the last report of every unit that is not finished."""
        for key, each in self._status.items():
            if each.state in ("waiting", "running", "busy"):
                done, total, facts = read_progress(self._store, key)
                self._status[key] = replace(each, done=done, total=total, facts=facts)
        return self._status

    def raise_failures(self) -> None:
        """Raise what went wrong, the first unit's error in words."""
        failed = [key for key, each in self._status.items() if each.state == "failed"]
        if not failed:
            return
        first = failed[0]
        if len(self._units) == 1 and first in self._errors:
            raise self._errors[first]
        blocked = sum(each.state == "blocked" for each in self._status.values())
        count = f"{len(failed)} of {len(self._units)} units failed"
        if blocked:
            count += f", {blocked} depend on them"
        cause = self._errors.get(first)
        raise PerdureError(f"{count}: {first}: {self._status[first].error}") from cause

    def _running(self) -> int:
        """Return how many units workers are running."""
        return sum(each.state == "running" for each in self._status.values())

    def _next(self, workers: int) -> Unit | None:
        """Return the unit to run next: of the first `UNITS_AHEAD` a worker that can be, the one furthest behind."""
        now = time.monotonic()
        ready = []
        for number, (key, unit) in enumerate(self._units.items()):
            state = self._status[key].state
            if state == "busy" and now >= self._try_again[key]:
                state = "waiting"
            if state != "waiting":
                continue
            before = {self._status[other].state for other in unit.after}
            if before & {"failed", "blocked"}:
                self._set(key, "blocked")
            elif before <= {"finished"}:
                ready.append((self._status[key].share, number, unit))
        if not ready:
            return None
        _, _, furthest_behind = min(ready[: UNITS_AHEAD * workers], key=lambda each: each[:2])
        return furthest_behind

    def _wait_for_others(self) -> bool:
        """Wait a little if another command is running a unit; return whether there is one."""
        if not any(each.state == "busy" for each in self._status.values()):
            return False
        failed = any(each.state == "failed" for each in self._status.values())
        if not self._announced and not failed:  # `waiting` may end this run, and a unit that failed would run again
            self._announced = True
            self._waiting()
        time.sleep(POLL_SECONDS)
        self._observe(self.refresh())
        return True

    def _record_end(self, ended: Ended) -> None:
        """Record how an attempt ended."""
        note = self._store.note_path("failures", ended.key)
        if ended.result is None:
            with suppress(OSError):  # a disk that takes no record must not hide the error itself
                write_atomic(note, json.dumps({"error": ended.error}) + "\n")
            self._set(ended.key, "failed", error=ended.error)
            return
        with suppress(OSError):
            note.unlink(missing_ok=True)
        if ended.result == "busy":
            self._try_again[ended.key] = time.monotonic() + BUSY_SECONDS
            self._set(ended.key, "busy")
            return
        done, total, facts = read_progress(self._store, ended.key)
        known = self._status[ended.key]
        if not facts or done < known.done:  # reported in this process, not through the store
            done = known.done
            total = known.total
            facts = dict(known.facts)
        state: UnitState = "waiting"
        if ended.result == "finished":
            state = "finished"
            done = total
            with suppress(OSError):
                self._store.note_path("progress", ended.key).unlink(missing_ok=True)
        self._status[ended.key] = replace(known, state=state, done=done, total=total, facts=facts)

    def _set(self, key: str, state: UnitState, error: str = "") -> None:
        self._status[key] = replace(self._status[key], state=state, error=error)

    def _reporter(self, key: str) -> Callable[..., None]:
        def report(done: float, total: float, **facts: float) -> None:
            self._status[key] = replace(self._status[key], done=done, total=total, facts=facts)
            self._observe(self._status)

        return report
