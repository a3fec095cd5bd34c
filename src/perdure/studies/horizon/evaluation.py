"""Evaluate a row of the grid on one split of start states: one step of the study."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from perdure.extrapolate import Extrapolation, extrapolate
from perdure.horizon import clock_from_json
from perdure.runs import Store
from perdure.studies.horizon.grid import Grid, Row, Split, evaluation_folder
from perdure.studies.horizon.training import policy_paths
from perdure.studies.study import RunOptions, StepProgress

TABLE = "lanes.parquet"
GROUPS = "groups"
START_SECONDS = 4.0
"""Seconds for starting processes."""


@dataclass(frozen=True)
class EvaluateRow:
    """All lanes of a row on one split: policies x clocks x start states."""

    grid: Grid
    row: Row
    split: Split
    out: Path

    measure = "lane steps"

    @property
    def key(self) -> str:
        """See `StudyStep`."""
        return f"{self.stage} {self.row.key}"

    @property
    def stage(self) -> str:
        """See `StudyStep`."""
        return f"evaluation {self.split.name}"

    @property
    def after(self) -> tuple[str, ...]:
        """See `StudyStep`."""
        return (f"training {self.row.key}",)

    @property
    def task(self) -> str:
        """See `StudyStep`."""
        return self.row.task

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
        """See `StudyStep`; a lane that falls costs less."""
        return float(self.lanes * self.grid.steps)

    def seconds(self, speed: float) -> float:
        """See `StudyStep`; acting costs a quarter of a lane step beside the bare task (make bench)."""
        return START_SECONDS + 1.25 * self.amount / speed

    def progress(self) -> StepProgress:
        """See `StudyStep`; units are lanes, running and failed ones are groups of them."""
        if not self.folder.is_dir():
            return StepProgress(self.lanes, 0)
        store = Store(self.folder)
        done = min(self.lanes, len(self._finished(store)))
        busy = sum(store.is_busy(key) for key in store.begun())
        failed = len(store.noted("failures"))
        return StepProgress(self.lanes, done, busy, failed, done / self.lanes)

    def _finished(self, store: Store) -> set[tuple[str, str, int]]:
        """Return the planned lanes that are in the store, as (policy's digest, clock, start state)."""
        digests = {_digest(path) for path in self.evaluation.policies if path.is_file()}
        clocks = {clock.label for clock in self.evaluation.deployment_clocks(None)} | {"none"}
        first, count = self.split.first_seed, self.split.seeds
        return {
            (digest, clock, seed)
            for key in store.keys(GROUPS)
            for digest, clock, seed in map(_lane, _lanes(store.config(key), self.grid.steps))
            if digest in digests and clock in clocks and first <= seed < first + count
        }

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


def _lanes(config: dict[str, Any], steps: int) -> list[Any]:
    return list(config["lanes"]) if config.get("steps") == steps else []


def _lane(written: Any) -> tuple[str, str, int]:
    digest, clock, seed = written
    return digest, "none" if clock is None else clock_from_json(clock).label, int(seed)


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()
