"""Evaluate a row of the grid on one split of start states: one step of the study."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import polars as pl
from numpy.typing import NDArray

from perdure.extrapolate import Extrapolation, extrapolate
from perdure.extrapolate.run import finished_lanes, read_lanes
from perdure.report import read_table
from perdure.runs import Store, file_digest
from perdure.studies.horizon.grid import Grid, Row, Split, evaluation_folder
from perdure.studies.horizon.row_step import RowStep
from perdure.studies.horizon.training import policy_paths
from perdure.studies.study import RunOptions, StepProgress

TABLE = "lanes.parquet"
GROUPS = "groups"
START_SECONDS = 4.0
"""Seconds for starting processes."""


@dataclass(frozen=True)
class EvaluateRow(RowStep):
    """All lanes of a row on one split: policies x clocks x start states."""

    split: Split

    @property
    def folder(self) -> Path:
        """Where lanes and table are kept."""
        return evaluation_folder(self.out, self.split.name, self.row)

    @property
    def evaluation(self) -> Extrapolation:
        """What is evaluated."""
        return Extrapolation(
            tuple(policy_paths(self.out, self.row)),
            self.grid.steps,
            self.grid.clocks(self.row) or ("default",),
            self.split.seeds,
            first_eval_seed=self.split.first_seed,
        )

    @property
    def clocks(self) -> tuple[str, ...]:
        """Labels of the clocks; "none" for a method without time-to-go input."""
        return tuple(clock.label for clock in self.evaluation.deployment_clocks(None)) or ("none",)

    @property
    def lanes(self) -> int:
        """How many there are."""
        return len(self.row.seeds) * len(self.clocks) * self.split.seeds

    @property
    def amount(self) -> float:
        """See `StudyStep`; a lane that falls costs less."""
        return float(self.lanes * self.grid.steps)

    def seconds(self, speed: float) -> float:
        """See `StudyStep`; acting costs a quarter of a lane step beside the bare task (make bench)."""
        return START_SECONDS + 1.25 * self.amount / speed

    def progress(self) -> StepProgress:
        """See `StudyStep`; units are lanes, running and failed ones are groups of them."""
        if not self.folder.is_dir():
            return StepProgress(self.lanes, 0)
        store, done = Store(self.folder), int(self._finished().sum())
        busy = sum(store.is_busy(key) for key in store.begun())
        failed = len(store.noted("failures"))
        return StepProgress(self.lanes, done, busy, failed, done / self.lanes)

    def _finished(self) -> NDArray[np.bool_]:
        """Return which lanes are in the store, shape (policies, clocks, start states)."""
        lanes = finished_lanes(self.folder, self.grid.steps, self.row.task)
        digests = [file_digest(path) if path.is_file() else "" for path in self.evaluation.policies]
        first = self.split.first_seed
        seeds = range(first, first + self.split.seeds)
        return np.array([[[(d, clock, seed) in lanes for seed in seeds] for clock in self.clocks] for d in digests])

    def read(self) -> pl.DataFrame | None:
        """Return the table of finished lanes; None where there is none. Nothing is simulated.

        A clock is in it if every policy was evaluated under it, with those start states, from the first on, that every
        policy has; in a confirmatory grid only if every lane is there. Without groups of lanes, `lanes.parquet` is read
        as it is.
        """
        if not (self.folder / GROUPS).is_dir():
            table = read_table(self.folder / TABLE)[0] if (self.folder / TABLE).is_file() else None
            partial = table is not None and self.grid.confirmatory and count_lanes(table) < self.lanes
            return None if partial else table
        start_states = np.cumprod(self._finished().all(axis=0), axis=1).sum(axis=1)
        if self.grid.confirmatory and (start_states < self.split.seeds).any():
            return None
        parts = []
        for count in sorted(set(start_states[start_states > 0].tolist()), reverse=True):
            clocks = [clock for clock, has in zip(self.clocks, start_states, strict=True) if has == count]
            known = ("default",) if clocks == ["none"] else tuple(clocks)
            parts.append(read_lanes(replace(self.evaluation, clocks=known, eval_seeds=count), self.folder))
        return pl.concat(parts) if parts else None

    def run(self, options: RunOptions) -> None:
        """See `StudyStep`."""
        command = f"perdure study horizon --scale {self.grid.name}"
        extrapolate(
            self.evaluation,
            self.folder,
            cores=options.cores,
            on=options.on,
            command=command,
            observe=options.observe,
            waiting=options.waiting,
        )


def count_lanes(table: pl.DataFrame) -> int:
    """Return the number of lanes in a table."""
    return table.select("policy", "train_seed", "clock", "eval_seed").n_unique()


def evaluate_row(grid: Grid, row: Row, split: Split, out: Path) -> EvaluateRow:
    """Return the step that evaluates a row on a split."""
    return EvaluateRow(grid, row, out, f"evaluation {split.name}", split)
