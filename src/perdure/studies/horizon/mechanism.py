"""Stage "mechanism": why a policy holds or falls, from short rollouts under the conditions of its training.

Every lane has a horizon T drawn as in training (evenly over its distribution) and counts down to it. Three tables:
`mechanism_rewards` (reward and falls against steps to go), `mechanism_values` (error and spread of the critic) and
`mechanism_actions` (how much the action depends on the time-to-go input).
"""

from __future__ import annotations

import json
import math
from pathlib import Path

import polars as pl

from perdure.horizon import Countdown
from perdure.policy import load_policy
from perdure.runs import Work, write_atomic
from perdure.schema import Real, Table
from perdure.studies.files import read_json_file, read_parquet_file
from perdure.studies.horizon.grid import Grid, Row
from perdure.studies.horizon.mechanism_actions import OWN, action_changes
from perdure.studies.horizon.mechanism_rewards import fall_rate, rewards_to_go
from perdure.studies.horizon.mechanism_values import tail_steps, value_measures, values_to_go
from perdure.studies.horizon.per_seed import PerSeed
from perdure.studies.horizon.rollouts import draw_horizons, roll_out

LANES = 8
BINS, ACTIONS, SUMMARY = "steps-to-go.parquet", "actions.parquet", "summary.json"
FIRST_SEED = 3_500_000
"""World seed of the first lane."""
MEASURES = ("fall rate", "value error", "value variance", "action dependence")
KNOWN = Table({}, optional=dict.fromkeys(MEASURES, Real()))
SCHEMA: dict[str, type[pl.DataType]] = {
    "setting": pl.String,
    "method": pl.String,
    "train_seed": pl.Int64,
    **dict.fromkeys(MEASURES, pl.Float64),
}


def mechanism_steps(grid: Grid, out: Path) -> list[PerSeed]:
    """Return one step for each row with policies."""
    return [_step(grid, row, out) for row in grid.rows if row.evaluated]


def _step(grid: Grid, row: Row, out: Path) -> PerSeed:
    function = "perdure.studies.horizon.mechanism:measure"
    return PerSeed(grid, row, out, "mechanism", function, {"lanes": LANES}, 1500.0 * LANES)


def measure(work: Work, *, path: str, lanes: int) -> None:
    """Write the mechanism tables of one policy in the work folder; the function of the stage's units."""
    policy = load_policy(path)
    horizons = draw_horizons(policy, lanes)
    timed = policy.protocol.embedding is not None
    clocks = [Countdown(float(horizon)) if timed else None for horizon in horizons]
    rollout = roll_out(policy, clocks, int(horizons.max()) + tail_steps(policy), FIRST_SEED)
    bins = rewards_to_go(rollout, horizons)
    values = values_to_go(policy, rollout, horizons)
    bins = bins.join(values, on="steps to go", how="left", maintain_order="left")
    bins.write_parquet(work.folder / BINS)
    found = {"fall rate": fall_rate(rollout, horizons), **value_measures(policy, rollout, horizons)}
    if timed:
        changes = action_changes(policy, rollout)
        changes.write_parquet(work.folder / ACTIONS)
        found["action dependence"] = float(changes.filter(pl.col("C") != OWN)["change"].to_numpy().mean())
    known = {name: value for name, value in found.items() if math.isfinite(value)}
    write_atomic(work.folder / SUMMARY, json.dumps(known, indent=1) + "\n")


def read_mechanism(grid: Grid, out: Path) -> pl.DataFrame:
    """Return the measures that are there, one row for each training run; null where a measure has no meaning."""
    rows = [
        {
            "setting": step.row.setting,
            "method": step.row.method,
            "train_seed": seed,
            **read_json_file(folder / SUMMARY, KNOWN),
        }
        for step in mechanism_steps(grid, out)
        for seed, folder in step.folders().items()
    ]
    return pl.DataFrame([{name: row.get(name) for name in SCHEMA} for row in rows], schema=SCHEMA)


def read_details(grid: Grid, out: Path, name: str) -> pl.DataFrame:
    """Return one of the stage's tables (`BINS`, `ACTIONS`), all training runs one below the other."""
    frames = [
        read_parquet_file(folder / name).select(
            pl.lit(step.row.setting).alias("setting"),
            pl.lit(step.row.method).alias("method"),
            pl.lit(seed).alias("train_seed"),
            pl.all(),
        )
        for step in mechanism_steps(grid, out)
        for seed, folder in step.folders().items()
        if (folder / name).is_file()
    ]
    return pl.concat(frames, how="diagonal") if frames else pl.DataFrame()
