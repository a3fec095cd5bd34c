"""The page keeps what others wrote, tables are rounded, and every figure has data that agree with the tables."""

import polars as pl
import pytest
from known_results import HORIZON, make_results

from perdure.report import read_table, write_table
from perdure.studies.files import write_csv
from perdure.studies.horizon.across_tasks import gain_table
from perdure.studies.horizon.analyze import make_figures
from perdure.studies.horizon.claims import CLAIMS
from perdure.studies.horizon.grid import evaluation_folder
from perdure.studies.horizon.page import BEGIN, END, write_page
from perdure.studies.horizon.page_sentences import MAIN_CLAIM
from perdure.studies.horizon.results import read_results
from perdure.studies.horizon.summaries import choice_table, condition_table

RUNS = {
    ("ppo", "none"): {0: 100.0, 1: 200.0, 2: 300.0},
    ("ppo-short", "none"): {0: None, 1: None, 2: None},
    ("geometric", "constant:100"): {0: 400.0, 1: 500.0, 2: 600.0},
    ("geometric", "constant:500"): {0: None, 1: 10.0, 2: 20.0},
    ("geometric", "countdown"): {0: 1.0, 1: 2.0, 2: 3.0},
}


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    return make_results(tmp_path_factory.mktemp("results"), RUNS)


def test_the_page_keeps_what_stands_around_the_markers(results, tmp_path):
    page = tmp_path / "README.md"
    page.write_text(f"# Mine\n\nBefore.\n\n{BEGIN}\nold\n{END}\n\nAfter.\n")
    write_page(page, results, (), ())
    text = page.read_text()
    assert text.startswith("# Mine\n\nBefore.\n")
    assert text.endswith("\nAfter.\n")
    assert "\nold\n" not in text
    write_page(page, results, (), ())
    assert page.read_text() == text


def test_a_page_without_markers_gets_them_at_its_end(results, tmp_path):
    page = tmp_path / "README.md"
    page.write_text("# Mine\n\nBefore.\n")
    write_page(page, results, (), ())
    assert page.read_text().startswith(f"# Mine\n\nBefore.\n\n{BEGIN}")


def test_the_page_shows_means_of_training_runs(results, tmp_path):
    text = write_page(tmp_path / "README.md", results, (), ()).read_text()
    # Gain: nobody earns anything idle, and a published policy 3 a step for 1,000 steps.
    assert "| Hopper-v3 | 200.0 (gain 0.07; 0 %; 3 x 2) | 500.0 (gain 0.17; 0 %; 3 x 2) |" in text
    # Seed 0 falls under constant:500 and earns 1: (1 + 10 + 20) / 3.
    assert "| Hopper-v3 | 10.33 (33 %) | 500.0 (0 %; C = 100) | 2.00 (0 %) |" in text


def test_a_share_of_some_runs_says_of_how_many(tmp_path):
    results = make_results(tmp_path / "results", RUNS)
    path = evaluation_folder(tmp_path / "results", "test", results.grid.rows[0]) / "lanes.parquet"
    frame = read_table(path)[0]
    write_table(
        path, frame.with_columns(outcome=pl.when(train_seed=1).then(pl.lit("unknown")).otherwise("outcome")), {}
    )
    text = write_page(tmp_path / "README.md", read_results(results.grid, tmp_path / "results"), (), ()).read_text()
    assert "| Hopper-v3 | 200.0 (gain 0.07; 0 % of 2; 3 x 2) |" in text


def test_the_page_begins_with_what_was_found(tmp_path):
    results = make_results(tmp_path / "results", RUNS, task="Swimmer-v3")
    text = write_page(tmp_path / "README.md", results, (), ()).read_text()
    assert "Swimmer-v3 0 % (0 %) against 0 % (0 %)." in text
    assert "under the cross-validated constant: Swimmer-v3 98 % lower" in text  # 10.3 beside 500


def test_where_no_c_is_chosen_the_method_is_shown_under_the_default_clock(tmp_path):
    results = make_results(tmp_path / "results", RUNS, task="Swimmer-v3", confirmatory=True)
    text = write_page(tmp_path / "README.md", results, (), list(make_figures(results))).read_text()
    assert "cross-validated" not in text
    assert "| task | discounted PPO | geometric time-to-go, always 500 steps to go |" in text
    assert "Swimmer-v3 0 % (0 %) against 33 % (33 %)." in text


def test_the_mean_over_tasks_is_student_with_more_freedom(tmp_path):
    """Two tasks with the same three gains: half the variance of one mean, and 2 + 2 degrees of freedom."""
    results = make_results(tmp_path / "results", RUNS, tasks=("Swimmer-v3", "HalfCheetah-v3"))
    row = gain_table(results).filter(pl.col("method") == "ppo").to_dicts()[0]
    half = 2.776445 * (100.0 / 3000.0) / 3**0.5 / 2**0.5  # gains: 100, 200, 300 of 3,000
    assert (row["gain"], row["upper"] - row["gain"]) == pytest.approx((200.0 / 3000.0, half))
    figures = list(make_figures(results))
    text = write_page(tmp_path / "README.md", results, (), figures).read_text()
    assert "mean over Swimmer-v3, HalfCheetah-v3 (95 % interval over training runs of these tasks; " in text
    assert "discounted PPO 0.07 (0.03 to 0.10; 3);" in text
    assert "The method's mean gain minus that of discounted PPO: 0.10 (" in text
    assert "in the input alone" not in text  # that control is not evaluated
    assert "](figures/gain.png)" in text
    (figure,) = (each for each in figures if each.name == "gain")
    assert "mean of 2 tasks" in str(figure.spec)


def test_the_control_without_the_input_stands_beside_the_method(tmp_path):
    control = {("random-horizon", "none"): {0: 100.0, 1: 200.0, 2: 300.0}}
    results = make_results(tmp_path / "results", RUNS | control, tasks=("Swimmer-v3", "HalfCheetah-v3"))
    text = write_page(tmp_path / "README.md", results, (), ()).read_text()
    assert "Minus the mean gain of *random horizon, no time-to-go*, which differs from the method in the " in text
    assert "input alone, it is 0.10 (" in text


def test_fewer_failures_with_a_lower_gain_are_named(tmp_path):
    """Seed 0 of PPO falls early; the others earn more than the method, all of whose runs last."""
    runs = {
        ("ppo", "none"): {0: None, 1: 2000.0, 2: 2500.0},
        ("geometric", "constant:100"): {0: 400.0, 1: 500.0, 2: 600.0},
    }
    text = write_page(tmp_path / "README.md", make_results(tmp_path / "a", runs, task="Swimmer-v3"), (), ()).read_text()
    assert "On Swimmer-v3 geometric time-to-go fails less often and gains less." in text
    runs["geometric", "constant:100"][2] = 6000.0
    text = write_page(tmp_path / "README.md", make_results(tmp_path / "b", runs, task="Swimmer-v3"), (), ()).read_text()
    assert "and gains less" not in text


def test_a_chosen_clock_that_is_not_yet_evaluated_is_left_out(tmp_path):
    """Validation chooses C = 100; the test start states so far have C = 500 alone."""
    test = {("geometric", "constant:500"): {0: 10.0, 1: 10.0, 2: 20.0}}
    validation = test | {("geometric", "constant:100"): {0: 400.0, 1: 500.0, 2: 600.0}}
    assert choice_table(make_results(tmp_path, test, validation)).is_empty()


def test_without_a_second_task_there_is_no_mean(tmp_path):
    assert gain_table(make_results(tmp_path, RUNS, task="Swimmer-v3")).is_empty()


def test_a_confirmatory_table_that_lacks_lanes_is_not_read(tmp_path):
    """Also where only the table was kept: `geometric` lacks a start state of one run."""
    results = make_results(tmp_path, RUNS, task="Swimmer-v3", confirmatory=True)
    assert set(results.test) == {"Swimmer-v3/ppo", "Swimmer-v3/ppo-short", "Swimmer-v3/geometric"}
    path = evaluation_folder(tmp_path, "test", results.grid.rows[-1]) / "lanes.parquet"
    frame = read_table(path)[0]
    write_table(path, frame.filter((pl.col("train_seed") != 2) | (pl.col("eval_seed") != 2001)), {})
    assert set(read_results(results.grid, tmp_path).test) == {"Swimmer-v3/ppo", "Swimmer-v3/ppo-short"}


def test_main_figures_come_first(results, tmp_path):
    text = write_page(tmp_path / "README.md", results, (), list(make_figures(results))).read_text()
    first, others = text.index("## Figures"), text.index("## More figures")
    assert (
        first < text.index("figures/return-by-c-hopper-v3.png") < others < text.index("figures/survival-hopper-v3.png")
    )


def test_conditions_hold_means_and_intervals(results):
    row = condition_table(results).filter(pl.col("method") == "ppo").to_dicts()[0]
    half = 4.302653 * 100.0 / 3**0.5  # Student's t for 2 degrees of freedom
    assert (row["return"], row["upper"] - row["return"]) == pytest.approx((200.0, half))


def test_the_choice_names_its_clocks(results):
    (row,) = choice_table(results).filter(pl.col("method") == "geometric").to_dicts()
    assert (row["chosen"], row["optimistic clock"], row["bias"]) == ("constant:100", "constant:100", 0.0)


def test_tables_have_six_digits_and_empty_cells(tmp_path):
    path = write_csv(tmp_path / "x.csv", pl.DataFrame({"a": [1.23456789, float("nan"), None], "b": [1, 2, 3]}))
    assert path.read_text() == "a,b\n1.23457,1\n,2\n,3\n"


def test_figures_show_what_the_tables_say(results):
    figures = {figure.name: figure for figure in make_figures(results)}
    assert {"figure-3-1-hopper-v3", "figure-3-2", "figure-a-2-hopper-v3", "survival-hopper-v3"} <= set(figures)
    shown = [row for row in values(figures["figure-3-2"].spec) if row.get("label") == "discounted PPO" and "low" in row]
    assert shown
    assert [row["x"] for row in shown] == pytest.approx([200.0 / (3.0 * HORIZON)] * len(shown), rel=1e-5)
    bars = {row["method"]: row for row in values(figures["verdicts-hopper-v3"].spec) if row["verdict"] == "holds"}
    assert bars["discounted PPO"]["share"] == 1.0


def test_a_task_without_a_published_policy_is_left_out_beside_one_that_has_it(tmp_path):
    results = make_results(tmp_path, RUNS, tasks=("Swimmer-v3", "Ant-v3"))
    for row in results.grid.rows:
        if row.task == "Ant-v3":
            path = evaluation_folder(tmp_path, "test", row) / "lanes.parquet"
            write_table(path, read_table(path)[0].with_columns(level_rate=pl.lit(float("nan"))), {})
    figures = {figure.name: figure for figure in make_figures(read_results(results.grid, tmp_path))}
    assert {row["row"] for row in values(figures["figure-3-2"].spec)} == {"Swimmer-v3"}
    assert "Not shown, for want of a published policy: Ant-v3." in figures["figure-3-2"].note
    assert {row["row"] for row in values(figures["gain"].spec)} == {"Swimmer-v3"}


def test_notes_name_the_number_of_training_runs(results):
    for figure in make_figures(results):
        assert "training runs" in figure.note or "Training runs" in figure.note


def values(spec):
    """Every row of data in a specification, whichever part of it holds them."""
    held = [spec.get("data", {}), *(layer.get("data", {}) for layer in spec["layer"])]
    sets = spec.get("datasets", {})
    return [row for each in held for row in each.get("values", sets.get(each.get("name"), []))]


def test_the_main_claim_of_the_page_is_registered():
    assert MAIN_CLAIM in {each.id for each in CLAIMS}
