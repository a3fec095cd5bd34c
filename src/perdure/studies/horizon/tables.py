"""Reduce extrapolation tables to one number for each training run, clock and measure."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import polars as pl

from perdure.report.groups import LANE_FAILURES, VERDICT
from perdure.studies.horizon.evaluation import evaluate_row
from perdure.studies.horizon.grid import Grid, Row

WITHIN = 1000
"""Steps of the measures "return within" and "failed within"."""
LATE = 0.1
"""Share of the test horizon, at its end, of the measure "reward late"."""
LANE = ("train_seed", "clock", "eval_seed")
MEASURED = (
    *("return", "return within", "reward late", "gain", "failed share", "failed within", "ended share", "hold share"),
    *("hold", "level", "steps to failure"),
)
"""Measures of `claim.MEASURES` that evaluation tables give."""
VERDICTS = ("holds", "decays", "fails silently", "falls", "diverges", "never worked", "cannot tell")


@dataclass(frozen=True, eq=False)
class RowTable:
    """The evaluation of one row on one split."""

    row: Row
    frame: pl.DataFrame
    """Columns of `perdure.report.schema`; `clock` is as on a command line: "constant:500", "countdown", "none"."""

    @cached_property
    def lanes(self) -> pl.DataFrame:
        """One row for each lane, with the measures."""
        return lane_measures(self.frame)

    @cached_property
    def runs(self) -> pl.DataFrame:
        """One row for each clock and training run: means over its lanes, `episodes` and shares of verdicts.

        Null where no lane has the measure.
        """
        shares = [(pl.col("verdict") == name).mean().alias(name) for name in VERDICTS if name != "holds"]
        means = [pl.col(name).mean() for name in MEASURED]
        keys = ["clock", "clock_kind", "clock_steps", "train_seed"]
        return (
            self.lanes.group_by(keys)
            .agg(pl.len().alias("episodes"), *means, *shares)
            .sort("clock_kind", "clock_steps", "train_seed")
            .select(
                pl.lit(self.row.setting).alias("setting"),
                pl.lit(self.row.method).alias("method"),
                pl.all(),
            )
        )


def read_rows(grid: Grid, out: Path, split: str, whole: bool = True) -> dict[str, RowTable]:
    """Return the evaluation of every row that is there, by its key; none where the grid lacks the split.

    Args:
        grid: Whose rows.
        out: Folder of the results.
        split: Name of the start states.
        whole: Keep all recorded steps, for curves; otherwise those that the measures need.
    """
    found: dict[str, RowTable] = {}
    if split not in {each.name for each in grid.splits}:
        return found
    for row in grid.rows:
        if row.evaluated and (frame := _read_row(grid, row, out, split)) is not None:
            kept = frame if whole else frame.filter(pl.col("step").is_in(list(_marks(frame))))
            found[row.key] = RowTable(row, kept)
    return found


def _read_row(grid: Grid, row: Row, out: Path, split: str) -> pl.DataFrame | None:
    step = evaluate_row(grid, row, grid.split(split), out)
    frame = step.read()
    if frame is None:
        return None
    first, seeds = step.split.first_seed, step.split.seeds
    frame = name_clocks(frame).filter(
        pl.col("eval_seed").is_between(first, first + seeds - 1) & pl.col("train_seed").is_in(row.seeds)
    )
    return frame if len(frame) else None


def name_clocks(frame: pl.DataFrame) -> pl.DataFrame:
    """Return clocks as on a command line: "constant:500", "periodic:500", "countdown" (to the test horizon)."""
    number = pl.col("clock_steps").fill_nan(0.0).cast(pl.Int64).cast(pl.String)
    whole = (pl.col("clock_kind") == "countdown") & (pl.col("clock_steps") == pl.col("test_horizon"))
    name = (
        pl.when(pl.col("clock_kind") == "none")
        .then(pl.lit("none"))
        .when(whole)
        .then(pl.lit("countdown"))
        .otherwise(pl.col("clock_kind") + ":" + number)
    )
    return frame.with_columns(clock=name)


def lane_measures(frame: pl.DataFrame) -> pl.DataFrame:
    """Return one row for each lane: where it stood at the end, and the measures.

    A policy that never worked has failed from the start: hold 0, no steps to failure. Where the verdict is "cannot
    tell", what says whether a lane failed is null.
    """
    within, before, horizon = _marks(frame)
    earlier = [
        frame.filter(pl.col("step") == step).select(*LANE, pl.col("return").alias(name))
        for step, name in ((within, "return within"), (before, "_before"))
    ]
    last = frame.filter(pl.col("step") == horizon)
    for each in earlier:
        last = last.join(each, on=LANE, how="left", maintain_order="left")

    def judged(measure: pl.Expr) -> pl.Expr:
        return pl.when(VERDICT != "cannot tell").then(measure.cast(pl.Float64))

    never = pl.col("policy_state") == "never worked"
    ended = pl.col("end_reason").is_in(["terminated", "diverged"])
    failed = pl.col("outcome").is_in(LANE_FAILURES) | never
    idle = pl.col("idle_rate")
    gain = (pl.col("return") - idle * pl.col("end_step")) / ((pl.col("level_rate") - idle) * horizon)
    steps = pl.when(never).then(0).when(failed).then(pl.col("failed_step")).otherwise(horizon)
    level = (pl.col("reference_rate") - pl.col("idle_rate")) / (pl.col("level_rate") - pl.col("idle_rate"))
    return last.with_columns(
        verdict=VERDICT,
        **{
            "reward late": (pl.col("return") - pl.col("_before")) / (horizon - before),
            "gain": gain,
            "failed share": judged(failed),
            "failed within": judged(failed & (steps < within)),
            "ended share": ended.cast(pl.Float64),
            "hold share": judged(VERDICT == "holds"),
            "hold": pl.when(ended | never).then(0.0).otherwise(pl.col("end_hold")),
            "level": level,
            "steps to failure": judged(steps),
        },
    ).drop("_before")


def _marks(frame: pl.DataFrame) -> tuple[int, int, int]:
    """Return the recorded steps of "return within", before the last tenth, and at the end."""
    horizon = int(frame["test_horizon"][0])
    steps = frame["step"].unique().sort().to_numpy()
    wanted = (min(WITHIN, horizon), (1.0 - LATE) * horizon)
    within, before = (int(steps[np.searchsorted(steps, step, side="right") - 1]) for step in wanted)
    return within, before, horizon


def all_runs(tables: Mapping[str, RowTable]) -> pl.DataFrame:
    """Return the runs of all rows, one below the other; an empty frame where there is none."""
    frames = [table.runs for table in tables.values()]
    return pl.concat(frames) if frames else pl.DataFrame()


def failure_places(tables: Mapping[str, RowTable]) -> pl.DataFrame:
    """Count, in failed lanes, the observation components that were first to leave their training range."""
    return pl.concat(list(_places(tables)) or [_NO_PLACES])


_NO_PLACES = pl.DataFrame(
    schema={
        "setting": pl.String,
        "method": pl.String,
        "verdict": pl.String,
        "left first": pl.String,
        "episodes": pl.UInt32,
    }
)


def _places(tables: Mapping[str, RowTable]) -> Iterator[pl.DataFrame]:
    for table in tables.values():
        lanes = table.lanes.filter(pl.col("failed share") > 0)
        place = pl.col("end_detail").str.extract(r"(observation\[\d+\]) left").fill_null("none left its range")
        counted = lanes.with_columns(place.alias("left first")).group_by("verdict", "left first").agg(episodes=pl.len())
        yield counted.sort("verdict", "episodes", "left first", descending=[False, True, False]).select(
            pl.lit(table.row.setting).alias("setting"), pl.lit(table.row.method).alias("method"), pl.all()
        )
