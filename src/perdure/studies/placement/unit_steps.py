"""A small measurement of the study: independent units, each of which writes one JSON summary."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import polars as pl

from perdure.runs import Store, Unit, Work, run_missing, write_atomic
from perdure.schema import Flag, Kind, Real, Table, Text, Whole
from perdure.studies.files import read_json_file
from perdure.studies.placement.grid import runs_folder
from perdure.studies.placement.row_step import SPEED_TASK, START_SECONDS
from perdure.studies.status import count_units
from perdure.studies.study import RunOptions, StepProgress

SUMMARY = "summary.json"
KINDS: Mapping[type[pl.DataType], Kind] = {
    pl.Boolean: Flag(),
    pl.String: Text(),
    pl.Int64: Whole(0),
    pl.Float64: Real(unknown=True),
}
"""Type of a column to what a summary may hold."""
TASK = "set_table"
"""The home task of these measurements."""


@dataclass(frozen=True)
class Measurement:
    """Units of SetTable episodes; each row of the table is a unit's summary."""

    key: str
    """Also the stage's name."""
    units: tuple[Unit, ...]
    """Their `size` is the number of episodes."""
    episode_cost: int
    """In steps of SPEED_TASK."""
    out: Path
    schema: Mapping[str, type[pl.DataType]]
    """Of the table."""

    measure = "episodes"
    after: tuple[str, ...] = ()
    task = SPEED_TASK

    @property
    def stage(self) -> str:
        """See `StudyStep`."""
        return self.key

    @property
    def amount(self) -> float:
        """See `StudyStep`."""
        return sum(unit.size for unit in self.units)

    def seconds(self, speed: float) -> float:
        """See `StudyStep`."""
        return START_SECONDS * len(self.units) + self.amount * self.episode_cost / speed

    def progress(self) -> StepProgress:
        """See `StudyStep`."""
        return count_units(runs_folder(self.out), {unit.key: unit.size for unit in self.units})

    def run(self, options: RunOptions) -> None:
        """See `StudyStep`."""
        run_missing(self.units, runs_folder(self.out), options.on, options.cores, options.observe, options.waiting)

    @property
    def _row(self) -> Table:
        return Table({name: KINDS[kind] for name, kind in self.schema.items()})

    def table(self) -> pl.DataFrame | None:
        """Return the summaries in the units' order; None unless all are there."""
        folder = runs_folder(self.out)
        if not folder.is_dir():
            return None
        store = Store(folder)
        if not all(store.done(unit.key, unit.config) for unit in self.units):
            return None
        rows = [read_json_file(store.get(unit.key) / SUMMARY, self._row) for unit in self.units]
        return pl.DataFrame(rows, schema=self.schema)


def leave(work: Work, summary: dict[str, Any]) -> None:
    """Write a unit's summary into its work folder."""
    write_atomic(work.folder / SUMMARY, json.dumps(summary, indent=1) + "\n")
