"""Tables and figures agree with results of known answer."""

import polars as pl
import pytest
from known_results import HORIZON, make_results

from studies.horizon.claims import SCORE, Claim, effect
from studies.horizon.figures import all_figures

RUNS = {
    ("ppo", "none"): {0: 100.0, 1: 200.0, 2: 300.0},
    ("ppo-short", "none"): {0: None, 1: None, 2: None},
    ("geometric", "constant:100"): {0: 400.0, 1: 500.0, 2: 600.0},
    ("geometric", "constant:500"): {0: None, 1: 10.0, 2: 20.0},
    ("geometric", "countdown"): {0: 1.0, 1: 2.0, 2: 3.0},
}
TWO = ("Swimmer-v3", "HalfCheetah-v3")
MEAN = Claim("", "", "ppo none", 0.0, "greater", tasks=TWO)


@pytest.fixture(scope="module")
def results():
    return make_results(RUNS)


def figures_of(results):
    return {figure.name: figure for figure in all_figures(results)}


def values(spec):
    """Every row of data in a specification, whichever part of it holds them."""
    held = [spec.get("data", {}), *(layer.get("data", {}) for layer in spec["layer"])]
    sets = spec.get("datasets", {})
    return [row for each in held for row in each.get("values", sets.get(each.get("name"), []))]


def test_the_mean_over_tasks_is_student_with_more_freedom():
    """Two tasks with the same three scores: half the variance of one mean, and 2 + 2 degrees of freedom."""
    results = make_results(RUNS, tasks=TWO)
    found = effect(MEAN, results.values)
    half = 2.776445 * (100.0 / 3000.0) / 3**0.5 / 2**0.5  # scores: 100, 200, 300 of 3,000
    assert (found.estimate, found.upper - found.estimate) == pytest.approx((200.0 / 3000.0, half))


def test_a_task_that_is_missing_leaves_no_mean():
    assert effect(MEAN, make_results(RUNS, task="Swimmer-v3").values) is None


def test_figures_show_what_the_tables_say(results):
    figures = figures_of(results)
    assert {"figure-3-1-hopper-v3", "figure-3-2", "figure-a-2-hopper-v3"} <= set(figures)
    shown = [row for row in values(figures["figure-3-2"].spec) if row.get("label") == "discounted PPO" and "low" in row]
    assert shown
    assert [row["x"] for row in shown] == pytest.approx([200.0 / (3.0 * HORIZON)] * len(shown), rel=1e-5)


def test_a_task_without_a_published_policy_is_left_out_beside_one_that_has_it():
    results = make_results(RUNS, tasks=("Swimmer-v3", "Ant-v3"))
    known = pl.when(pl.col("setting") != "Ant-v3").then("published_rate").otherwise(float("nan"))
    score = pl.when(pl.col("setting") != "Ant-v3").then(SCORE).otherwise(float("nan"))
    object.__setattr__(
        results, "episodes", results.episodes.with_columns(known.alias("published_rate"), score.alias(SCORE))
    )
    figures = figures_of(results)
    assert {row["row"] for row in values(figures["figure-3-2"].spec)} == {"Swimmer-v3"}


def test_notes_name_the_number_of_training_runs(results):
    for figure in all_figures(results):
        assert "training runs" in figure.note or "Training runs" in figure.note
