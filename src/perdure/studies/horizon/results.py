"""Read the results of all steps of the study, once."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import polars as pl

from perdure.studies.files import read_parquet_file
from perdure.studies.horizon.choose_clock import cross_validated, optimistic, under
from perdure.studies.horizon.claim import Condition
from perdure.studies.horizon.grid import Grid, Row
from perdure.studies.horizon.tables import MEASURED, RowTable, all_runs, read_rows
from perdure.studies.horizon.training import EPISODES, seed_folders

TEST, VALIDATION = "test", "validation"
LAST_OF_TRAINING = 0.1
"""Share of the training steps, at the end, of the measure "training return"."""


@dataclass(frozen=True, eq=False)
class Results:
    """The tables of a grid. Rows that are not there yet are missing from every table."""

    grid: Grid
    out: Path
    test: Mapping[str, RowTable]
    validation: Mapping[str, RowTable]
    rules: pl.DataFrame
    """Clocks chosen without a sweep: setting, method, rule, train_seed, clock, lane_steps."""
    mechanism: pl.DataFrame
    """Per training run: setting, method, train_seed, and the measures of the mechanism tables."""

    @cached_property
    def runs(self) -> pl.DataFrame:
        """Means of each clock and training run on test start states."""
        return all_runs(self.test)

    @cached_property
    def validation_runs(self) -> pl.DataFrame:
        """The same on validation start states."""
        return all_runs(self.validation)

    @cached_property
    def training(self) -> pl.DataFrame:
        """Mean return of the last training episodes: setting, method, train_seed, "training return"."""
        rows = [
            {"setting": row.setting, "method": row.method, "train_seed": seed, "training return": _last_return(folder)}
            for row in self.grid.rows
            for seed, folder in seed_folders(self.out, row).items()
        ]
        return pl.DataFrame(rows, schema=_TRAINING)

    @property
    def constant(self) -> Condition:
        """The method under a constant C: the cross-validated one, or the default where the grid chooses none."""
        return Condition("geometric", "constant:500" if self.grid.confirmatory else "chosen")

    def of(self, row: Row, split: str = TEST) -> pl.DataFrame:
        """Return the runs of one row on one split; an empty frame where it is not evaluated."""
        table = (self.test if split == TEST else self.validation).get(row.key)
        return pl.DataFrame() if table is None else table.runs

    def values(self, setting: str, condition: Condition, measure: str = "return") -> dict[int, float]:
        """Return a measure of each training run under a condition, by training seed; {} where it is not there."""
        row = self.grid.row(setting, condition.method)
        if row is None:
            return {}
        if measure not in MEASURED:
            table = self.training if measure == "training return" else self.mechanism
            return _column(table, row, measure)
        test = self.of(row)
        if test.is_empty():
            return {}
        return under(test, self.clocks(row, condition.clock), measure)

    def start_states(self, setting: str, method: str) -> int:
        """Return the number of test start states of each training run; 0 where none is evaluated."""
        row = self.grid.row(setting, method)
        runs = pl.DataFrame() if row is None else self.of(row)
        return 0 if runs.is_empty() else int(runs["episodes"].min())  # type: ignore[arg-type]

    def swept(self, setting: str, method: str, kind: str) -> dict[float, str]:
        """Return C to clock, by rising C, of the test lanes under clocks of one kind."""
        row = self.grid.row(setting, method)
        runs = pl.DataFrame() if row is None else self.of(row)
        if runs.is_empty():
            return {}
        clocks = runs.filter(pl.col("clock_kind") == kind).select("clock_steps", "clock").unique().sort("clock_steps")
        return dict(clocks.iter_rows())

    def is_planned(self, setting: str, method: str, measure: str) -> bool:
        """Return whether a measure of a method is there, or will be when every step has run."""
        row = self.grid.row(setting, method)
        if row is None or not row.evaluated:
            return False
        found = self.mechanism.filter((pl.col("setting") == setting) & (pl.col("method") == method))
        return found.is_empty() or measure not in found.columns or found[measure].is_not_null().any()

    def clocks(self, row: Row, rule: str) -> dict[int, str]:
        """Return the clock that a rule gives each training run of a row; {} if the results do not decide it."""
        test, validation = self.of(row), self.of(row, VALIDATION)
        if rule in ("chosen", "chosen periodic"):
            kind = "constant" if rule == "chosen" else "periodic"
            known = not validation.is_empty() and kind in validation["clock_kind"]
            return cross_validated(validation, kind) if known else {}
        if rule in ("value", "bandit"):
            found = self.rules.filter(
                (pl.col("setting") == row.setting) & (pl.col("method") == row.method) & (pl.col("rule") == rule)
            )
            return dict(found.select("train_seed", "clock").iter_rows())
        if rule == "best":
            return dict.fromkeys(row.seeds, optimistic(test)) if "constant" in test["clock_kind"] else {}
        return dict.fromkeys(row.seeds, rule)


_TRAINING = {"setting": pl.String, "method": pl.String, "train_seed": pl.Int64, "training return": pl.Float64}


def read_results(grid: Grid, out: Path) -> Results:
    """Read what is there; simulate nothing."""
    from perdure.studies.horizon.mechanism import read_mechanism
    from perdure.studies.horizon.rules import read_rules

    return Results(
        grid,
        out,
        read_rows(grid, out, TEST),
        read_rows(grid, out, VALIDATION, whole=False),
        read_rules(grid, out),
        read_mechanism(grid, out),
    )


def _last_return(folder: Path) -> float:
    episodes = read_parquet_file(folder / EPISODES)
    last = float(episodes["step"].max() or 0.0)  # type: ignore[arg-type]
    late = episodes.filter(pl.col("step") >= (1.0 - LAST_OF_TRAINING) * last)
    return float(late["return"].mean() or 0.0)  # type: ignore[arg-type]


def _column(table: pl.DataFrame, row: Row, name: str) -> dict[int, float]:
    if name not in table.columns:
        return {}
    found = table.filter((pl.col("setting") == row.setting) & (pl.col("method") == row.method))
    return {seed: value for seed, value in found.select("train_seed", name).iter_rows() if value is not None}
