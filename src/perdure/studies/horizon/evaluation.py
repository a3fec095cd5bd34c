"""Evaluate a row of the grid on one split of start states: one step of the study."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from perdure.extrapolate import Extrapolation, extrapolate
from perdure.horizon import clock_from_json
from perdure.runs import Store, file_digest
from perdure.studies.horizon.grid import Grid, Row, Split, evaluation_folder
from perdure.studies.horizon.row_step import RowStep
from perdure.studies.horizon.training import policy_paths
from perdure.studies.study import Count, How

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
    def lanes(self) -> int:
        """How many there are."""
        clocks = len(self.evaluation.deployment_clocks(None)) if self.grid.clocks(self.row) else 1
        return len(self.row.seeds) * clocks * self.split.seeds

    @property
    def amount(self) -> float:
        """See `Step`; a lane that falls costs less."""
        return float(self.lanes * self.grid.steps)

    def seconds(self, speed: float) -> float:
        """See `Step`; acting costs a quarter of a lane step beside the bare task (make bench)."""
        return START_SECONDS + 1.25 * self.amount / speed

    def count(self) -> Count:
        """See `Step`; units are lanes, running and failed ones are groups of them."""
        if not self.folder.is_dir():
            return Count(self.lanes, 0)
        store = Store(self.folder)
        done = min(self.lanes, len(self._finished(store)))
        busy = sum(store.is_busy(key) for key in store.begun())
        failed = len(store.noted("failures"))
        return Count(self.lanes, done, busy, failed, done / self.lanes)

    def _finished(self, store: Store) -> set[tuple[str, str, int]]:
        """Return the planned lanes that are in the store, as (policy's digest, clock, start state)."""
        digests = {file_digest(path) for path in self.evaluation.policies if path.is_file()}
        clocks = {clock.label for clock in self.evaluation.deployment_clocks(None)} | {"none"}
        first, count = self.split.first_seed, self.split.seeds
        return {
            (digest, clock, seed)
            for key in store.keys(GROUPS)
            for digest, clock, seed in map(_lane, _lanes(store.config(key), self.grid.steps))
            if digest in digests and clock in clocks and first <= seed < first + count
        }

    def run(self, how: How) -> None:
        """See `Step`."""
        command = f"perdure study horizon --scale {self.grid.name}"
        extrapolate(
            self.evaluation,
            self.folder,
            cores=how.cores,
            on=how.on,
            command=command,
            observe=how.observe,
            waiting=how.waiting,
        )


def evaluate_row(grid: Grid, row: Row, split: Split, out: Path) -> EvaluateRow:
    """Return the step that evaluates a row on a split."""
    return EvaluateRow(grid, row, out, f"evaluation {split.name}", split)


def _lanes(config: dict[str, Any], steps: int) -> list[Any]:
    return list(config["lanes"]) if config.get("steps") == steps else []


def _lane(written: Any) -> tuple[str, str, int]:
    digest, clock, seed = written
    return digest, "none" if clock is None else clock_from_json(clock).label, int(seed)
