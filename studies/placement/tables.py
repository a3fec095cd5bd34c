"""The committed tables of the study, the rows of new logs in them, and the tables that pages include."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, replace
from itertools import pairwise, product
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from perdure.errors import PerdureError
from perdure.home.evaluate.analysis import AT_RELEASE, SAME_PLACEMENT, Analysis, paired_difference
from perdure.home.evaluate.comparison import describe_task, interval_text, percent
from perdure.home.evaluate.counts import COUNTS
from perdure.home.evaluate.outcomes import COUNTINGS
from perdure.home.evaluate.strategy import COLUMNS as STRATEGY_COLUMNS
from perdure.home.evaluate.strategy import Strategy
from perdure.home.sim.objects import KINDS, ROLLING
from studies.files import read_csv, write_csv
from studies.placement.grid import DRAG, RELEASES, STRATEGIES, TASKS, THESIS_ROWS, TRAINED

Tables = dict[str, pl.DataFrame]
"""Tables by name. Each row says what was run in the columns of `Strategy`, without the label of `--names`."""
Row = dict[str, Any]
BOUNDS = ("estimate", "lower", "upper")
SETTING = tuple(name for name in STRATEGY_COLUMNS if name not in ("disturbance", "label"))
"""Columns that say what was run: release strategy, world, planner, fallback."""
KEYS = ("task", "split", *SETTING)
_KEYS = dict.fromkeys(KEYS, pl.String)
SIDES = ("first", "second")
"""Of a comparison, each with `SETTING`: "first place"."""
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
    "counts": {
        **_KEYS,
        **dict.fromkeys(("train_seeds", "eval_seeds", "episodes", "taken_over"), pl.Int64),
        **{f"{name} {bound}": pl.Float64 for name in COUNTS for bound in ("mean", "lower", "upper")},
        "method": pl.String,
    },
    "differences": {
        **dict.fromkeys(("task", "split"), pl.String),
        **{f"{side} {name}": pl.String for side in SIDES for name in SETTING},
        **{"units": pl.Int64, "method": pl.String},
        **{f"{what} {name}": pl.Float64 for what in ("episodes", "placements") for name in BOUNDS},
    },
    "release-speed": {
        **{"interval": pl.Int64, "hand_over": pl.Boolean, "objects": pl.String, "placements": pl.Int64},
        **{"share_stayed": pl.Float64, "median_speed": pl.Float64},
    },
}
"""Columns of every CSV file, see `perdure.home.evaluate.analysis`: shares, [m], [m/s], [deg]. `differences` are second
minus first; `interval` counts from 0 between `SPEED_BOUNDS`."""
OPTIONAL = {name for name, columns in COLUMNS.items() for name in columns if name.endswith(("lower", "upper", "error"))}
OPTIONAL |= {"median_speed", *(f"{name} mean" for name in COUNTS)}
THESIS = {("set_table", "rl"): ("41.8 %", "45.4 %"), ("set_table", "ik"): ("65.3 %", "18.0 %")}
"""Success and failed placements in section 2.3 of the thesis."""
PAIRS = (*(("rl", other) for other in (*RELEASES[1:], *TRAINED)), ("stop", "ik"), ("stop", "guarded"))
"""Strategies that are compared over the same episodes, beside open and closed loop: second minus first."""
GROUPS = {"sphere": "apples", "bowl": "bowls", "cylinder": "cans", "box": "boxes", "rounded_box": "boxes"}
"""Collision shape to what tables call objects of that shape."""
SHAPES = ("apples", "cans", "bowls", "boxes")
SPEED_BOUNDS = (0.0, 0.02, 0.05, 0.1, 0.15, 0.2, 0.3, np.inf)
"""Bounds of the intervals of release speed in [m/s]."""
INTERVALS = (*(f"{low:g} to {high:g}" for low, high in pairwise(SPEED_BOUNDS[:-1])), f"over {SPEED_BOUNDS[-2]:g}")
MIN_PLACEMENTS = 20
"""Placements; with fewer, the figure draws no point."""


def read_tables(folder: Path) -> Tables:
    """Return the tables in a folder of CSV files; those of which there is no file have no rows.

    Raises:
        PerdureError: A file is damaged.
    """
    return {name: read_csv(folder / f"{name}.csv", columns, OPTIONAL) for name, columns in COLUMNS.items()}


def write_tables(folder: Path, tables: Tables) -> list[Path]:
    """Write all tables that have rows as CSV; the same tables give the same bytes."""
    return [write_csv(folder / f"{name}.csv", table) for name, table in tables.items() if len(table)]


def with_logs(known: Tables, analysis: Analysis, hand_overs: pl.DataFrame, counts: pl.DataFrame) -> Tables:
    """Return tables in which rows of logs replace rows about the same; all others stay."""
    new = {name: getattr(analysis, name) for name in ("success", "seeds", "stages", "outcomes", "modes", "kinds")}
    new["modes"] = new["modes"].filter(counting="stabilizing")
    new["hand-overs"] = hand_overs
    new["counts"] = counts
    merged = dict(known)
    subjects = analysis.success.select(KEYS)
    for name, table in new.items():
        kept = known[name].join(subjects, on=KEYS, how="anti", maintain_order="left")
        columns = table.select(pl.col(each).cast(kind) for each, kind in kept.schema.items())
        merged[name] = pl.concat([kept, columns]).sort(KEYS, maintain_order=True)
    # Differences: those of these logs, and known ones of which neither side has other numbers now.
    fresh = pl.DataFrame(list(_differences(analysis)), schema=COLUMNS["differences"])
    order = ("task", "split", *side_columns("second"), *side_columns("first"))
    pairs = known["differences"].join(fresh, on=order, how="anti", maintain_order="left")
    changed = _changed(known["success"], merged["success"])
    for side in SIDES:
        pairs = pairs.join(changed, left_on=("task", "split", *side_columns(side)), right_on=KEYS, how="anti")
    return {**merged, "differences": pl.concat([pairs, fresh]).sort(order)}


def _changed(before: pl.DataFrame, after: pl.DataFrame) -> pl.DataFrame:
    """Return the `KEYS` of rows that have other numbers than before, or are new; CSV files hold six digits."""
    numbers = [
        pl.col(name).fill_nan(None).round_sig_figs(6) for name, kind in after.schema.items() if kind == pl.Float64
    ]
    unchanged = before.with_columns(numbers)
    return after.with_columns(numbers).join(unchanged, on=after.columns, how="anti", nulls_equal=True).select(KEYS)


def side_columns(side: str) -> tuple[str, ...]:
    """Return the columns of one side of a comparison: "first place", "first world", ..."""
    return tuple(f"{side} {name}" for name in SETTING)


def _differences(analysis: Analysis) -> Iterable[dict[str, Any]]:
    for (task, split), group in analysis.success.group_by("task", "split", maintain_order=True):
        strategies = [Strategy(**row) for row in group.select(STRATEGY_COLUMNS).to_dicts()]
        for before, after in product(strategies, strategies):
            if not _is_compared(before, after):
                continue
            first = {"task": task, "split": split, **asdict(before)}
            second = {"task": task, "split": split, **asdict(after)}
            try:
                won = paired_difference(analysis.episodes.filter(**first), analysis.episodes.filter(**second))
                put = analysis.placements.filter(**first), analysis.placements.filter(**second)
                stayed = paired_difference(*put, keys=SAME_PLACEMENT)
            except PerdureError:  # they share no episode or no placement
                continue
            yield {
                **{"task": task, "split": split},
                **{f"first {name}": getattr(before, name) for name in SETTING},
                **{f"second {name}": getattr(after, name) for name in SETTING},
                **{"units": won.count, "method": won.method},
                **{f"episodes {name}": float(getattr(won, name)) for name in BOUNDS},
                **{f"placements {name}": float(getattr(stayed, name)) for name in BOUNDS},
            }


def _is_compared(before: Strategy, after: Strategy) -> bool:
    """Return whether two strategies differ in one thing: the release (`PAIRS`), the closed loop, or its fallback."""
    with_oracle = replace(before, planner="closed", fallback="oracle")
    without = replace(before, planner="closed", fallback="none")
    if (before.place, after.place) in PAIRS:
        return after == replace(before, place=after.place)
    if before.planner == "open":
        return after == with_oracle
    return before == with_oracle and after == without


def release_speeds(placements: pl.DataFrame) -> pl.DataFrame:
    """Return how many placements of each group and interval of speed there are, and which share stayed.

    Counted are all `eval` placements of the closed loop with drag only. Those after a hand-over are kept apart.
    """
    known = placements.filter(pl.col("place").is_in(STRATEGIES))
    rows = known.filter(split="eval", world=DRAG, planner="closed", fallback="oracle")
    counted = rows.group_by(
        pl.Series("interval", np.digitize(rows["object_speed"].to_numpy(), SPEED_BOUNDS[1:], right=True)),
        hand_over=pl.col("place").is_in(RELEASES[1:]),
        objects=pl.col("kind").replace_strict({name: GROUPS[kind.shape] for name, kind in KINDS.items()}),
    ).agg(placements=pl.len(), share_stayed=pl.col("stabilizing").mean(), median_speed=pl.col("object_speed").median())
    columns = COLUMNS["release-speed"]
    return counted.select(pl.col(name).cast(kind) for name, kind in columns.items()).sort(*list(columns)[:3])


def success_rows(tables: Tables, split: str = "eval") -> list[Row]:
    """Return the rows of `success` of a split that the grid has, with their `rolling` [m], in order.

    The closed loop without fallback is left out.
    """
    return [row for row in _grid_rows(tables["success"].filter(split=split)) if _has_usual_fallback(row)]


def _has_usual_fallback(row: Row) -> bool:
    return bool(row["planner"] == "open" or row["fallback"] == "oracle")


def _grid_rows(table: pl.DataFrame) -> list[Row]:
    """Return the rows of a table that the grid has, with `rolling` [m], in order."""
    known = {row.strategy: row.rolling for row in THESIS_ROWS}
    rows = []
    for row in table.to_dicts():
        strategy = Strategy(**{name: row[name] for name in SETTING})
        if strategy in known:
            rows.append({**row, "rolling": known[strategy]})

    def order(row: Row) -> tuple[Any, ...]:
        setting = row["rolling"], row["planner"] != "open", row["fallback"] == "none"
        return TASKS.index(row["task"]), STRATEGIES.index(row["place"]), *setting

    return sorted(rows, key=order)


def share(row: Mapping[str, Any], way: str = "stabilizing") -> str:
    """Return a share with its 95 % interval: "18.6 % [0, 43]"; nothing for an unknown one."""
    return "" if row[f"{way} mean"] is None else interval_text({**row, f"{way} standard_error": None}, way, digits=0)


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
                    found[f"unaided{where}"] = percent(row["unaided"] / row["episodes"])
    return _table(cells.values())


def rolling_table(tables: Tables) -> pl.DataFrame:
    """Return success in the closed loop, and that unaided, of tasks and strategies that ran at several resistances."""
    cells: dict[tuple[str, str], dict[str, str]] = {}
    for row in success_rows(tables):
        if row["planner"] == "closed":
            alone = percent(row["unaided"] / row["episodes"])
            _cells(cells, row)[f"{1000 * row['rolling']:g} mm"] = f"{share(row)}; {alone}"
    return _table(each for each in cells.values() if len(each) > 3)


def thesis_table(tables: Tables) -> pl.DataFrame:
    """Return what the thesis has numbers of: latched success, failed placements and cans, known layouts, open loop."""
    rows = []
    for row in success_rows(tables, "val"):
        of = {name: row[name] for name in KEYS}
        success, failed = THESIS.get((row["task"], row["place"]), ("", ""))
        stages = tables["outcomes"].filter(pl.col("outcome").str.starts_with("place_"), **of)
        unstable = tables["kinds"].filter(**of)
        cans = unstable.filter("cylinder")["failures"].sum()
        rows.append(
            {"task": describe_task(row["task"]), "release": f"`{row['place']}`", "thesis": success}
            | {"here (latched)": share(row, "latched"), "failed at a placement, thesis": failed}
            | {"failed at a placement, here": percent(stages["count"].sum() / row["episodes"])}
            | {"cans among unstable placements": f"{cans} of {unstable['failures'].sum()}"}
        )
    return _table(rows)


def counts_page_table(tables: Tables) -> pl.DataFrame:
    """Return the four counts of every row of the default world on an unseen layout that was counted."""
    rows = []
    for row in _grid_rows(tables["counts"].filter(split="eval")):
        if row["rolling"] != ROLLING:
            continue
        cells = {"task": describe_task(row["task"]), "release": f"`{row['place']}`", "planner": row["planner"]}
        cells["fallback"] = row["fallback"] if row["planner"] == "closed" else ""
        for name in COUNTS:
            cells[name.replace("_", " ")] = share(row, name)
        cells["oracle took over"] = f"{row['taken_over']} of {row['episodes']}"
        rows.append(cells)
    return _table(rows)


def _cells(cells: dict[tuple[str, str], dict[str, str]], row: Row) -> dict[str, str]:
    names = {"task": describe_task(row["task"]), "release": f"`{row['place']}`"}
    return cells.setdefault((row["task"], row["place"]), names)


PAGE_TABLES: Mapping[str, Callable[[Tables], pl.DataFrame]] = {
    "tasks": task_table,
    "rolling": rolling_table,
    "thesis": thesis_table,
    "counts": counts_page_table,
}
"""Name after `table:` in a page to the function that makes the table."""
