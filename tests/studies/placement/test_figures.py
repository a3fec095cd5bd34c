"""What figures show of tables worked out by hand."""

import polars as pl

from studies.placement.figures import draw_figures, speed_figures, strategy_figures
from studies.placement.tables import COLUMNS, read_tables, success_rows

KEYS = {"task": "set_table", "split": "eval"}


def empty(tmp_path):
    return read_tables(tmp_path / "none")


def test_no_rows_no_figure(tmp_path):
    assert list(draw_figures(empty(tmp_path))) == []


def test_release_speed_draws_shares_of_enough_placements_released_in_motion():
    rows = [(0, True, 20, 0.9), (2, True, 40, 0.25), (3, True, 19, 0.1), (4, False, 40, 0.8)]
    values = [(number, moving, "apples", count, share, None) for number, moving, count, share in rows]
    (figure,) = speed_figures(pl.DataFrame(values, schema=COLUMNS["release-speed"], orient="row"))
    chart = figure.spec
    points = {(row["x"], row["y"]) for data in chart["datasets"].values() for row in data if {"x", "y"} <= row.keys()}
    assert points == {("0 to 0.02", 0.9), ("0.05 to 0.1", 0.25)}
    assert "apples (n = 60)" in str(chart)


def test_rows_come_by_task_world_and_strategy(tmp_path):
    names = ["stop drag", "rl", "rl drag", "delta-50-in-200 drag", "ik drag hull-apple"]
    base = dict.fromkeys(empty(tmp_path)["success"].columns)
    rows = [{**base, **KEYS, "strategy": name} for name in names]
    tables = {"success": pl.DataFrame(rows, schema=empty(tmp_path)["success"].schema)}
    assert [row["strategy"] for row in success_rows(tables, "eval")] == [
        *("rl drag", "delta-50-in-200 drag", "stop drag"),
        *("ik drag hull-apple", "rl"),
    ]
    assert success_rows(tables, "eval", "drag hull-apple")[0]["place"] == "ik"
    assert success_rows(tables, "val") == []


def test_the_figure_of_strategies_has_a_row_for_each_task_and_world(tmp_path):
    names = ["rl drag", "ik drag", "rl drag hull-apple"]
    base = dict.fromkeys(empty(tmp_path)["success"].columns)
    numbers = {
        "train_seeds": 3,
        "episodes": 30,
        "stabilizing mean": 0.5,
        "stabilizing lower": 0.2,
        "stabilizing upper": 0.8,
    }
    rows = [{**base, **KEYS, **numbers, "strategy": name} for name in names]
    tables = {**empty(tmp_path), "success": pl.DataFrame(rows, schema=empty(tmp_path)["success"].schema)}
    (figure,) = strategy_figures(tables)
    text = str(figure.spec)
    assert "'SetTable'" in text
    assert "'SetTable, apple a convex hull'" in text
    assert "n = 3 training seeds. Small open marks: each seed (n = 10 episodes each)" in figure.note
