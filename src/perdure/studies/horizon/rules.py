"""Stage "rules": the choices of rules without a sweep for each training run, and their cost."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import polars as pl

from perdure.extrapolate import Extrapolation
from perdure.horizon import Constant
from perdure.policy import load_policy
from perdure.runs import Work, write_atomic
from perdure.schema import Items, Real, Table, Text, Whole
from perdure.studies.files import read_json_file
from perdure.studies.horizon.choose_clock_bandit import choose_by_halving
from perdure.studies.horizon.choose_clock_value import choose_by_value
from perdure.studies.horizon.grid import SWEPT, Grid, Row
from perdure.studies.horizon.per_seed import PerSeed

FILE = "choices.json"
CHOICES = Items(
    Table({"rule": Text(), "clock": Text(), "lane_steps": Whole(0), "scores": Table({}, others=Real(infinite=True))})
)
SCHEMA = {
    "setting": pl.String,
    "method": pl.String,
    "rule": pl.String,
    "train_seed": pl.Int64,
    "clock": pl.String,
    "lane_steps": pl.Int64,
}


def rule_steps(grid: Grid, out: Path) -> list[PerSeed]:
    """Return one step for each row whose input depends on C."""
    return [_step(grid, row, out) for row in grid.rows if row.evaluated and row.method in SWEPT]


def _step(grid: Grid, row: Row, out: Path) -> PerSeed:
    clocks = Extrapolation((Path("any"),), grid.steps, grid.clocks(row)).deployment_clocks(None)
    candidates = sorted(float(clock.steps) for clock in clocks if isinstance(clock, Constant) and clock.steps > 0)
    settings = {"candidates": candidates, "most_steps": grid.steps}
    return PerSeed(grid, row, out, "rules", "perdure.studies.horizon.rules:choose", settings, 50_000.0)


def choose(work: Work, *, path: str, candidates: list[float], most_steps: int) -> None:
    """Write the choice of every rule for one policy in the work folder; the function of the stage's units."""
    policy, clocks = load_policy(path), [Constant(steps) for steps in candidates]
    found = [choose_by_value(policy, clocks), choose_by_halving(policy, clocks, most_steps)]
    choices: list[dict[str, Any]] = [
        {
            "rule": choice.rule,
            "clock": f"constant:{choice.clock.steps:.0f}",
            "lane_steps": choice.lane_steps,
            "scores": {f"{clock.steps:.0f}": score for clock, score in choice.scores.items()},
        }
        for choice in found
    ]
    write_atomic(work.folder / FILE, json.dumps(choices, indent=1) + "\n")


def read_rules(grid: Grid, out: Path) -> pl.DataFrame:
    """Return the choices that are there, one row for each training run and rule."""
    rows = [
        {"setting": step.row.setting, "method": step.row.method, "train_seed": seed, **choice}
        for step in rule_steps(grid, out)
        for seed, folder in step.folders().items()
        for choice in read_json_file(folder / FILE, CHOICES)
    ]
    return pl.DataFrame([{name: row[name] for name in SCHEMA} for row in rows], schema=SCHEMA)
