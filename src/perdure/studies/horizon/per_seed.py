"""A stage of short rollouts: one unit for each training run of a row."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from perdure.runs import Store, Unit, file_digest, run_missing
from perdure.studies.horizon.row_step import RowStep
from perdure.studies.horizon.training import policy_paths
from perdure.studies.status import count_units
from perdure.studies.study import RunOptions, StepProgress

VERSION = 1
"""Raised when the functions of these units give other numbers."""


@dataclass(frozen=True)
class PerSeed(RowStep):
    """Units of one stage and row; the stage is also the folder of the store: OUT/STAGE."""

    function: str
    """See `Unit`; called with the policy's path and `settings`."""
    settings: Mapping[str, Any]
    """What the result depends on beside the policy; JSON."""
    lane_steps: float
    """Of each unit, about."""

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
        digest = file_digest(path)
        config = {"version": VERSION, "stage": self.stage, "policy": digest, **self.settings}
        arguments = {"path": str(path.resolve()), **self.settings}
        return Unit(self._key(seed), config, self.function, arguments, size=self.lane_steps)

    def _key(self, seed: int) -> str:
        return f"{self.row.key}/seed-{seed}"

    def progress(self) -> StepProgress:
        """See `StudyStep`."""
        sizes = {self._key(seed): self.lane_steps for seed in self.row.seeds}
        return count_units(self.store, sizes, {unit.key: unit.config for unit in self.units()})

    def run(self, options: RunOptions) -> None:
        """See `StudyStep`."""
        run_missing(self.units(), self.store, options.on, options.cores, options.observe, options.waiting)

    def folders(self) -> dict[int, Path]:
        """Return the folder of each finished unit, by training seed.

        Raises:
            StoreError: A unit was finished by another version, or with another policy or other settings.
        """
        if not self.store.is_dir():
            return {}
        store = Store(self.store)
        units = {unit.key: unit for unit in self.units()}
        known = {seed: units[key] for seed in self.row.seeds if (key := self._key(seed)) in units}
        return {seed: store.get(unit.key) for seed, unit in known.items() if store.done(unit.key, unit.config)}
