"""A stage of short rollouts: one unit for each training run of a row."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from perdure.runs import Store, Unit, make_workers, read_status, run_units
from perdure.studies.horizon.grid import Grid, Row
from perdure.studies.horizon.training import policy_paths
from perdure.studies.study import RunOptions, StepProgress

VERSION = 1
"""Raised when the functions of these units give other numbers."""


@dataclass(frozen=True)
class PerSeed:
    """Units of one stage and row."""

    grid: Grid
    row: Row
    out: Path
    stage: str
    """Also the folder of the store: OUT/STAGE."""
    function: str
    """See `Unit`; called with the policy's path and `settings`."""
    settings: Mapping[str, Any]
    """What the result depends on beside the policy; JSON."""
    lane_steps: float
    """Of each unit, about."""

    measure = "lane steps"

    @property
    def key(self) -> str:
        """See `StudyStep`."""
        return f"{self.stage} {self.row.key}"

    @property
    def after(self) -> tuple[str, ...]:
        """See `StudyStep`."""
        return (f"training {self.row.key}",)

    @property
    def task(self) -> str:
        """See `StudyStep`."""
        return self.row.task

    @property
    def amount(self) -> float:
        """See `StudyStep`."""
        return self.lane_steps * len(self.row.seeds)

    def seconds(self, speed: float) -> float:
        """See `StudyStep`."""
        return 2.0 * self.amount / speed

    @property
    def store(self) -> Path:
        """Folder of the store."""
        return self.out / self.stage

    def units(self) -> list[Unit]:
        """Return the units of the training runs that are finished."""
        paths = zip(self.row.seeds, policy_paths(self.out, self.row), strict=True)
        return [self._unit(seed, path) for seed, path in paths if path.is_file()]

    def _unit(self, seed: int, path: Path) -> Unit:
        digest = hashlib.sha256(path.read_bytes()).hexdigest()
        config = {"version": VERSION, "stage": self.stage, "policy": digest, **self.settings}
        arguments = {"path": str(path.resolve()), **self.settings}
        return Unit(f"{self.row.key}/seed-{seed}", config, self.function, arguments, size=self.lane_steps)

    @cached_property
    def _total(self) -> int:
        return len(self.row.seeds)

    def progress(self) -> StepProgress:
        """See `StudyStep`."""
        units = self.units()
        if not self.store.is_dir() or not units:
            return StepProgress(self._total, 0)
        store, status = Store(self.store), read_status(units, self.store)
        open_units = [unit for unit in units if status[unit.key].state != "finished"]
        done = len(units) - len(open_units)
        return StepProgress(
            total=self._total,
            done=done,
            running=sum(store.is_busy(unit.key) for unit in open_units),
            failed=sum(store.note_path("failures", unit.key).exists() for unit in open_units),
            share=done / self._total,
        )

    def run(self, options: RunOptions) -> None:
        """See `StudyStep`."""
        store, units = Store(self.store), self.units()
        missing = [unit for unit in units if not store.done(unit.key, unit.config)]
        if missing:
            run_units(units, self.store, make_workers(options.on, missing, options.cores), options.observe)

    def folders(self) -> dict[int, Path]:
        """Return the folder of each finished unit, by training seed."""
        if not self.store.is_dir():
            return {}
        store = Store(self.store)
        keys = {seed: f"{self.row.key}/seed-{seed}" for seed in self.row.seeds}
        return {seed: store.get(key) for seed, key in keys.items() if store.done(key)}
