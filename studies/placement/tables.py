"""The committed tables of the study, the rows of new logs in them, and the tables that pages include."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from perdure.errors import PerdureError
from perdure.home.evaluate.analysis import AT_RELEASE, GROUP, SAME_PLACEMENT, Analysis, paired_difference
from perdure.home.evaluate.comparison import describe_task, interval_text, percent
from perdure.home.evaluate.outcomes import COUNTINGS, Counting
from perdure.home.sim.objects import KINDS, ROLLING
from studies.files import read_csv, write_csv
from studies.placement.grid import RELEASES, STRATEGIES, TASKS, THESIS_ROWS, VARIANTS

Tables = dict[str, pl.DataFrame]
"""Tables by name, with names of strategies as logs have them ("ik drag")."""
Row = dict[str, Any]
BOUNDS = ("estimate", "lower", "upper")
_KEYS = {"task": pl.String, "split": pl.String, "strategy": pl.String, "world": pl.String}
_PAIR = {"task": pl.String, "split": pl.String, "world": pl.String, "first": pl.String, "second": pl.String}
COLUMNS: Mapping[str, Mapping[str, type[pl.DataType]]] = {
    "success": {
        **_KEYS,
        **dict.fromkeys(("train_seeds", "eval_seeds", "episodes"), pl.Int64),
        **{f"{way} {name}": pl.Float64 for way in COUNTINGS for name in ("mean", "lower", "upper")},
        **{f"{way} standard_error": pl.Float64 for way in COUNTINGS},
        **{"method": pl.String, "did_not_last": pl.Int64, "final": pl.Int64, "unaided": pl.Int64},
    },
    "seeds": {**_KEYS, "train_seed": pl.Int64, **dict.fromkeys(COUNTINGS, pl.Float64)},
    "stages": {**_KEYS, "counting": pl.String, "stage": pl.String, "mean": pl.Float64},
    "outcomes": {**_KEYS, "outcome": pl.String, "count": pl.Int64},
    "modes": {**_KEYS, "counting": pl.String, "stage": pl.String, "cause": pl.String, "count": pl.Int64},
    "kinds": {
        **_KEYS,
        **{"kind": pl.String, "cylinder": pl.Boolean, "placements": pl.Int64, "failures": pl.Int64},
        **dict.fromkeys(AT_RELEASE, pl.Float64),
    },
    "hand-overs": {**_KEYS, "outcome": pl.String, "count": pl.Int64},
    "differences": {
        **_PAIR,
        **{"units": pl.Int64, "method": pl.String},
        **{f"{what} {name}": pl.Float64 for what in ("episodes", "placements") for name in BOUNDS},
    },
    "release-speed": {
        **{"interval": pl.Int64, "alone": pl.Boolean, "objects": pl.String, "placements": pl.Int64},
        **{"share_stayed": pl.Float64, "median_speed": pl.Float64},
    },
}
"""Columns of every CSV file, see `perdure.home.evaluate.analysis`: shares, [m], [m/s], [deg]. `differences` are second
minus first; `interval` counts from 0 between `SPEED_BOUNDS`."""
OPTIONAL = {name for name, columns in COLUMNS.items() for name in columns if name.endswith(("lower", "upper", "error"))}
OPTIONAL |= {"world", "median_speed"}
PAIRS = (*(("rl", other) for other in (*RELEASES[1:], *VARIANTS)), ("stop", "ik"), ("stop", "guarded"))
"""Strategies that are compared over the same episodes: (first, second), second minus first."""
DRAG = "drag closed"
"""The world in which release speeds are compared."""
GROUPS = {"sphere": "apples", "bowl": "bowls", "cylinder": "cans", "box": "boxes", "rounded_box": "boxes"}
"""Collision shape to what tables call objects of that shape."""
SHAPES = ("apples", "cans", "bowls", "boxes")
SPEED_BOUNDS = (0.0, 0.02, 0.05, 0.1, 0.15, 0.2, 0.3, np.inf)
"""Bounds of the intervals of release speed in [m/s]."""
INTERVALS = (*(f"{low:g} to {high:g}" for low, high in pairwise(SPEED_BOUNDS[:-1])), f"over {SPEED_BOUNDS[-2]:g}")
MIN_PLACEMENTS = 20
"""Placements; with fewer, the figure draws no point and the table shows no share."""


def full_name(strategy: str = "strategy") -> pl.Expr:
    """Return the name of a strategy in its world, "ik drag"."""
    return pl.concat_str(pl.col(strategy), pl.lit(" "), pl.col("world")).str.strip_chars_end()


def read_tables(folder: Path) -> Tables:
    """Return the tables in a folder of CSV files; those of which there is no file have no rows.

    Raises:
        PerdureError: A file is damaged.
    """
    tables = {name: read_csv(folder / f"{name}.csv", columns, OPTIONAL) for name, columns in COLUMNS.items()}
    for name, table in tables.items():
        if "world" in table.columns:
            table = table.with_columns(pl.col("world").fill_null(""))
            tables[name] = (
                table.with_columns(strategy=full_name()).drop("world") if "strategy" in table.columns else table
            )
    return tables


def write_tables(folder: Path, tables: Tables) -> list[Path]:
    """Write all tables that have rows as CSV; the same tables give the same bytes."""
    written = []
    for name, table in tables.items():
        if "strategy" in table.columns:
            parts = pl.col("strategy").str.splitn(" ", 2).struct
            table = table.with_columns(strategy=parts[0], world=parts[1].fill_null(""))
        if len(table):
            written.append(write_csv(folder / f"{name}.csv", table.select(COLUMNS[name].keys())))
    return written


def with_logs(known: Tables, analysis: Analysis, hand_overs: pl.DataFrame) -> Tables:
    """Return tables in which rows of logs replace rows about the same; all others stay."""
    new = {name: getattr(analysis, name) for name in ("success", "seeds", "stages", "outcomes", "modes", "kinds")}
    new["modes"] = new["modes"].filter(counting="stabilizing")
    new["hand-overs"] = hand_overs
    merged, subjects = dict(known), analysis.success.select(GROUP)
    for name, table in new.items():
        kept = known[name].join(subjects, on=GROUP, how="anti", maintain_order="left")
        columns = table.select(pl.col(each).cast(kind) for each, kind in kept.schema.items())
        merged[name] = pl.concat([kept, columns]).sort(GROUP, maintain_order=True)
    pairs = known["differences"]
    for side in ("first", "second"):
        named = subjects.rename({"strategy": "name"})
        pairs = (
            pairs.with_columns(name=full_name(side)).join(named, on=("task", "split", "name"), how="anti").drop("name")
        )
    fresh = pl.DataFrame(list(_differences(analysis)), schema=COLUMNS["differences"])
    order = ("task", "split", "second", "first", "world")
    return {**merged, "differences": pl.concat([pairs, fresh]).sort(order)}


def _differences(analysis: Analysis) -> Iterable[dict[str, Any]]:
    for task, split in analysis.success.select("task", "split").unique(maintain_order=True).rows():
        episodes, placements = (t.filter(task=task, split=split) for t in (analysis.episodes, analysis.placements))
        for world in _worlds(episodes):
            for pair in PAIRS:
                before, after = (f"{strategy} {world}".strip() for strategy in pair)
                try:
                    won = paired_difference(episodes.filter(strategy=before), episodes.filter(strategy=after))
                    put = placements.filter(strategy=before), placements.filter(strategy=after)
                    stayed = paired_difference(*put, keys=SAME_PLACEMENT)
                except PerdureError:  # they share no episode or no placement
                    continue
                yield {
                    **{"task": task, "split": split, "world": world, "first": pair[0], "second": pair[1]},
                    **{"units": won.count, "method": won.method},
                    **{f"episodes {name}": float(getattr(won, name)) for name in BOUNDS},
                    **{f"placements {name}": float(getattr(stayed, name)) for name in BOUNDS},
                }


def _worlds(rows: pl.DataFrame) -> list[str]:
    """Return the worlds in a table, which follow a strategy's first word: "drag closed"."""
    return sorted({name.partition(" ")[2] for name in rows["strategy"].unique()})


def release_speeds(placements: pl.DataFrame) -> pl.DataFrame:
    """Return how many placements of each group and interval of speed there are, and which share stayed.

    Counted are all `eval` placements of the closed loop with drag only. Those of policies alone are kept apart from
    those after a hand-over.
    """
    place = pl.col("strategy").str.strip_suffix(f" {DRAG}")
    rows = placements.filter(pl.col("strategy").str.ends_with(f" {DRAG}"), place.is_in(STRATEGIES), split="eval")
    counted = rows.group_by(
        pl.Series("interval", np.digitize(rows["object_speed"].to_numpy(), SPEED_BOUNDS[1:], right=True)),
        alone=~place.is_in(RELEASES[1:]),
        objects=pl.col("kind").replace_strict({name: GROUPS[kind.shape] for name, kind in KINDS.items()}),
    ).agg(placements=pl.len(), share_stayed=pl.col("stabilizing").mean(), median_speed=pl.col("object_speed").median())
    columns = COLUMNS["release-speed"]
    return counted.select(pl.col(name).cast(kind) for name, kind in columns.items()).sort(*list(columns)[:3])


def success_rows(tables: Tables, split: str = "eval") -> list[Row]:
    """Return the rows of `success` of a split with `place`, `planner` and `rolling` [m], in order."""
    known = {row.strategy: row for row in THESIS_ROWS}
    rows = []
    for row in tables["success"].filter(split=split).to_dicts():
        if found := known.get(row["strategy"]):
            rows.append({**row, **{name: getattr(found, name) for name in ("place", "planner", "rolling")}})
    return sorted(rows, key=lambda row: (TASKS.index(row["task"]), STRATEGIES.index(row["place"]), row["rolling"]))


def share(row: Mapping[str, Any] | None, way: Counting = "stabilizing") -> str:
    """Return a success with its 95 % interval: "18.6 % [0, 43]"; nothing for no row."""
    return "" if row is None else interval_text({**row, f"{way} standard_error": None}, way, digits=0)


def _table(rows: Iterable[Mapping[str, str]]) -> pl.DataFrame:
    return pl.DataFrame(list(rows), infer_schema_length=None).fill_null("")


def task_table(tables: Tables) -> pl.DataFrame:
    """Return success in the default world: a row for each task and release, open and closed loop, other layouts."""
    cells: dict[tuple[str, str], dict[str, str]] = {}
    for split, where in (("eval", ""), ("eval-2", ", five other layouts")):
        for row in success_rows(tables, split):
            if row["place"] in RELEASES and row["rolling"] == ROLLING:
                found = _cells(cells, row)
                found[f"{row['planner']}{where}"] = share(row)
                if row["planner"] == "closed":
                    found[f"policies alone{where}"] = percent(row["unaided"] / row["episodes"])
    return _table(cells.values())


def rolling_table(tables: Tables) -> pl.DataFrame:
    """Return success in the closed loop by rolling resistance: a row for each task and strategy."""
    cells: dict[tuple[str, str], dict[str, str]] = {}
    for row in success_rows(tables):
        if row["planner"] == "closed":
            _cells(cells, row)[f"{1000 * row['rolling']:g} mm"] = share(row)
    return _table(cells.values())


def _cells(cells: dict[tuple[str, str], dict[str, str]], row: Row) -> dict[str, str]:
    names = {"task": describe_task(row["task"]), "release": f"`{row['place']}`"}
    return cells.setdefault((row["task"], row["place"]), names)


def speed_table(tables: Tables) -> pl.DataFrame:
    """Return which share of placements stayed, one row for each interval of release speed."""
    counts, rows = tables["release-speed"], []
    for number, name in enumerate(INTERVALS):
        row = {"release speed [m/s]": name}
        for alone in (True, False):
            for group in SHAPES:
                part = counts.filter(interval=number, alone=alone, objects=group).select("placements", "share_stayed")
                n, stayed = part.row(0) if len(part) else (0, 0.0)
                few = f"{round(stayed * n)} of {n}" if n else "-"
                cell = f"{100 * stayed:.0f} % of {n}" if n >= MIN_PLACEMENTS else few
                row[f"{group}, {'policies alone' if alone else 'hand-overs'}"] = cell
        rows.append(row)
    return _table(rows)


PAGE_TABLES: Mapping[str, Callable[[Tables], pl.DataFrame]] = {
    "tasks": task_table,
    "rolling": rolling_table,
    "release-speed": speed_table,
}
"""Name after `table:` in a page to the function that makes the table."""
