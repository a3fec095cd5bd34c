"""The committed tables of the study, and the rows of new logs and measurements."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import polars as pl

from perdure.home.evaluate.outcomes import analyze
from perdure.home.evaluate.page import read_assignment
from perdure.studies.files import read_csv
from perdure.studies.placement import halt_in_noise, hand_over, release_speed
from perdure.studies.placement.grid import DRAG, Grid
from perdure.studies.placement.results import Results
from perdure.studies.placement.row_step import RunRow
from perdure.studies.placement.summaries import with_logs

STRATEGIES = Path("tables", "strategies.json")
SPEEDS, HAND_OVER, NOISE = (Path("tables", f"{name}.csv") for name in ("release-speed", "hand-over", "halt-in-noise"))


@dataclass(frozen=True)
class Tables:
    """Everything that figures and texts are made from. A measurement that was never made has no rows."""

    results: Results
    speeds: pl.DataFrame
    hand_over: pl.DataFrame
    noise: pl.DataFrame


def read_tables(out: Path) -> Tables:
    """Return the tables that are in a folder of results.

    Raises:
        StudyError: A file is damaged.
    """
    return Tables(
        Results.read(out / STRATEGIES),
        read_csv(out / SPEEDS, release_speed.SCHEMA, optional=("median_speed",)),
        read_csv(out / HAND_OVER, hand_over.SCHEMA),
        read_csv(out / NOISE, halt_in_noise.SCHEMA, optional=("let_go_outside",)),
    )


def update_tables(grid: Grid, out: Path) -> Tables:
    """Return the tables with the numbers of finished rows and measurements; all others keep theirs."""
    known = read_tables(out)
    logs = {row: RunRow(grid, row, out).logs() for row in grid.rows}
    measured = [step.table() for step in (hand_over.hand_over_step(grid, out), halt_in_noise.noise_step(grid, out))]
    handed, noise = (
        old if new is None else new for old, new in zip((known.hand_over, known.noise), measured, strict=True)
    )
    if not any(logs.values()):
        return Tables(known.results, known.speeds, handed, noise)
    records, assignment = read_assignment(sorted(path for paths in logs.values() for path in paths))
    analysis = analyze(records)
    # The speeds are of all these rows together: some of them alone would be another sample.
    pooled = [bool(logs[row]) for row in grid.rows if (row.split, row.world) == ("eval", DRAG)]
    speeds = release_speed.release_speeds(analysis.placements) if pooled and all(pooled) else known.speeds
    return Tables(with_logs(known.results, analysis, assignment), speeds, handed, noise)
