"""What figures show of tables worked out by hand."""

import polars as pl

from perdure.home.evaluate.strategy import Strategy
from studies.placement.figures import draw_figures, rolling_figures, speed_figures
from studies.placement.tables import COLUMNS, PAGE_TABLES, SETTING, read_tables, success_rows

KEYS = {"task": "set_table", "split": "eval"}


def empty(tmp_path):
    return read_tables(tmp_path / "none")


def test_no_rows_no_figure(tmp_path):
    assert list(draw_figures(empty(tmp_path))) == []


def test_release_speed_draws_shares_of_enough_placements_without_a_hand_over():
    rows = [(0, False, 20, 0.9), (2, False, 40, 0.25), (3, False, 19, 0.1), (4, True, 40, 0.8)]
    values = [(number, moving, "apples", count, share, None) for number, moving, count, share in rows]
    (figure,) = speed_figures(pl.DataFrame(values, schema=COLUMNS["release-speed"], orient="row"))
    chart = figure.spec
    points = {(row["x"], row["y"]) for data in chart["datasets"].values() for row in data if {"x", "y"} <= row.keys()}
    assert points == {("0 to 0.02", 0.9), ("0.05 to 0.1", 0.25)}
    assert "apples (n = 60)" in str(chart)


def closed(place, world=""):
    return Strategy(place, world, "closed", "oracle")


def success(tmp_path, strategies, **numbers):
    base = dict.fromkeys(empty(tmp_path)["success"].columns)
    rows = []
    for strategy in strategies:
        named = {name: getattr(strategy, name) for name in SETTING}
        rows.append({**base, **KEYS, "episodes": 30, "train_seeds": 3, **numbers, **named})
    return {**empty(tmp_path), "success": pl.DataFrame(rows, schema=empty(tmp_path)["success"].schema)}


def test_rows_come_by_task_strategy_and_rolling_resistance(tmp_path):
    alone = Strategy("rl", "", "closed", "none")
    drag = [closed("rl", "drag only"), closed("gentle", "drag only")]
    tables = success(tmp_path, [closed("stop"), Strategy("rl"), *drag, closed("rl"), alone, Strategy("made-up")])
    assert [(row["place"], row["planner"], row["rolling"]) for row in success_rows(tables)] == [
        ("rl", "closed", 0.0),
        ("rl", "open", 0.0012),
        ("rl", "closed", 0.0012),
        ("gentle", "closed", 0.0),
        ("stop", "closed", 0.0012),
    ]
    assert success_rows(tables, "val") == []


def test_tables_of_the_page_have_a_column_for_each_loop_and_each_rolling_resistance(tmp_path):
    numbers = {"stabilizing mean": 0.9, "stabilizing lower": 0.8, "stabilizing upper": 1.0, "unaided": 24}
    tables = success(tmp_path, [Strategy("rl"), closed("rl"), closed("rl", "drag only")], **numbers)
    said = "90.0 % [80, 100]"
    assert PAGE_TABLES["tasks"](tables).to_dicts() == [
        {
            "task": "SetTable",
            "release": "`rl`",
            "open": said,
            "closed": said,
            "unaided": "80.0 %",
        }
    ]
    assert PAGE_TABLES["rolling"](tables).to_dicts() == [
        {"task": "SetTable", "release": "`rl`", "0 mm": f"{said}; 80.0 %", "1.2 mm": f"{said}; 80.0 %"}
    ]


def test_the_figure_of_rolling_has_a_curve_for_each_strategy_with_all_four(tmp_path):
    worlds = ("drag only", "rolling 0.1 mm", "rolling 0.4 mm", "")
    names = [closed("rl", world) for world in worlds] + [closed("stop", world) for world in worlds[1:]]
    numbers = {"stabilizing mean": 0.5, "stabilizing lower": 0.2, "stabilizing upper": 0.8}
    (figure,) = rolling_figures(success(tmp_path, names, **numbers))
    assert "open at once" in str(figure.spec)
    assert "stop first" not in str(figure.spec)
    assert "n = 3 training seeds each; n = 30 episodes each" in figure.note
