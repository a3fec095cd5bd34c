"""What figures count, against the committed table worked out by hand."""

import polars as pl
import pytest

from perdure.studies.placement.figure_cylinders import cylinder_figures, shape_counts
from perdure.studies.placement.figure_outcomes import outcome_counts, outcome_figures
from perdure.studies.placement.figure_stages import stage_figures
from perdure.studies.placement.figure_strategies import strategy_figures
from perdure.studies.placement.release_speed import SCHEMA, speed_figures
from perdure.studies.placement.results import Results, chosen, strategy_and_world

SUCCESS = {"mean": 0.25, "standard_error": 0.0, "lower": 0.0, "upper": 0.6, "method": "", "train_seeds": [0.2, 0.3]}


def row(strategy="rl drag", split="val", task="set_table", kinds=None):
    stages = ["open_0", "pick_0", "place_0", "close_0", "open_1", "pick_1", "place_1", "close_1"]
    counts = {name: {"placements": p, "not_stable": bad} for name, (p, bad) in (kinds or {}).items()}
    return {
        **{"task": task, "split": split, "strategy": strategy, "episodes": 20, "seeds": {"train": 2, "eval": 1}},
        **{"latched": SUCCESS, "stabilizing": SUCCESS, "stages": {"stabilizing": dict.fromkeys(stages, 0.25)}},
        **{"kinds": counts, "failed": 13, "failed_at": {"place_0": 4, "place_1": 6}, "did_not_last": 2},
    }


def test_outcomes_sum_to_all_episodes():
    counts = outcome_counts(row())
    assert counts == {"success": 5, "success that did not last": 2, "place_0": 4, "place_1": 6, "other": 3}
    assert sum(counts.values()) == 20


def test_cans_are_cylinders_and_bowls_are_not():
    kinds = {"005_tomato_soup_can": (10, 4), "007_tuna_fish_can": (5, 1), "024_bowl": (8, 2), "013_apple": (3, 3)}
    assert shape_counts(row(kinds=kinds)) == {True: (5, 15), False: (5, 11)}


def test_figures_are_drawn_for_rows_that_are_there():
    results = Results(rows=(row(), row("ik drag"), row("rl drag", "eval")))
    assert [figure.name for figure in outcome_figures(results)] == [
        "figure-2-1-val",
        "figure-2-3-val",
        "figure-2-1-eval",
    ]
    assert [figure.name for figure in stage_figures(results)] == [
        "figure-2-2-val-set-table",
        "figure-2-2-eval-set-table",
    ]
    assert [figure.name for figure in strategy_figures(results)] == ["strategies"]
    assert list(cylinder_figures(results)) == []  # no can is placed


@pytest.mark.parametrize("draw", [outcome_figures, stage_figures, cylinder_figures, strategy_figures])
def test_no_rows_no_figure(draw):
    assert list(draw(Results())) == []


def test_release_speed_draws_shares_of_enough_placements_released_in_motion():
    rows = [(0, True, 20, 0.9), (2, True, 40, 0.25), (3, True, 19, 0.1), (4, False, 40, 0.8)]
    values = [(number, moving, "apples", count, share, None) for number, moving, count, share in rows]
    (figure,) = speed_figures(pl.DataFrame(values, schema=SCHEMA, orient="row"))
    chart = figure.chart.to_dict()
    points = {(row["x"], row["y"]) for data in chart["datasets"].values() for row in data if {"x", "y"} <= row.keys()}
    assert points == {("0 to 0.02", 0.9), ("0.05 to 0.1", 0.25)}
    assert "apples (n = 60)" in str(chart)


def test_new_rows_replace_those_about_the_same():
    old, other, new = row(), row("ik drag"), {**row(), "episodes": 40}
    merged = Results(("a",), (old, other)).merge(["b"], [new], [])
    assert merged.commands == ("a", "b")
    assert merged.rows == (other, new)


def test_a_name_is_a_strategy_in_a_world():
    assert strategy_and_world(row("ik+ drag hull-apple")) == ("ik+", "drag hull-apple")
    assert strategy_and_world(row("delta-50-in-200")) == ("delta-50-in-200", "")
    rows = [row("stop drag", "eval"), row("rl", "eval"), row("rl drag", "eval"), row()]
    assert [found["strategy"] for found in chosen(rows, "eval")] == ["rl drag", "stop drag", "rl"]
