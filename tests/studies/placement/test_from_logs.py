"""One episode is run as a unit of the study; its logs replace the committed rows about the same and nothing else."""

import shutil
from dataclasses import replace
from pathlib import Path

import polars as pl
import pytest

from perdure.errors import PerdureError
from perdure.home.evaluate.protocol import protocol_units
from perdure.runs import Store, attempt
from studies.placement.figures import speed_figures
from studies.placement.grid import Row
from studies.placement.study import update_tables
from studies.placement.tables import PAGE_TABLES, read_tables, write_tables

COMMITTED = Path(__file__).parents[3] / "results" / "placement" / "tables"
ROW = Row("set_table", "stop", "eval", "closed", 0.0, 1, 1, 1, 1)
GRID = (ROW,)
WHAT = {"place": "stop", "world": "drag only", "planner": "closed", "fallback": "oracle"}
SUBJECT = {"task": "set_table", "split": "eval", **WHAT}


@pytest.fixture(scope="module")
def out(tmp_path_factory):
    """Results with the committed tables and the logs of one episode."""
    folder = tmp_path_factory.mktemp("placement")
    shutil.copytree(COMMITTED, folder / "tables")
    (unit,) = protocol_units(ROW.protocol(), ROW.command, Store(folder / "runs"))
    attempt(folder / "runs", unit)
    return folder


@pytest.fixture(scope="module")
def after(out):
    return update_tables(GRID, out)


def others(table):
    return table.join(pl.DataFrame(SUBJECT), on=list(SUBJECT), how="anti", maintain_order="left")


def test_a_row_of_which_episodes_are_missing_keeps_its_numbers(out):
    more = (replace(ROW, eval_seeds=2),)
    before, same = read_tables(out / "tables"), update_tables(more, out)
    assert all(same[name].equals(before[name]) for name in before)


def test_a_row_without_policies_is_refused(out):
    with pytest.raises(PerdureError, match="is shipped for place-delta-7 on set_table"):
        list(protocol_units(replace(ROW, place="delta-7").protocol(), "", Store(out)))


@pytest.mark.parametrize("name", ["success", "seeds", "stages", "outcomes", "modes", "kinds", "hand-overs", "counts"])
def test_logs_replace_their_rows_and_no_other(out, after, name):
    before = read_tables(out / "tables")
    assert others(after[name]).equals(others(before[name]))
    assert not after[name].filter(**SUBJECT).equals(before[name].filter(**SUBJECT))


def test_logs_remove_the_differences_of_replaced_rows(out, after):
    before = read_tables(out / "tables")["differences"]
    gone = before.join(after["differences"], on=before.columns, how="anti", nulls_equal=True)
    assert sorted(gone.select("task", "split", "second place", "first place").rows()) == [
        ("set_table", "eval", "guarded", "stop"),
        ("set_table", "eval", "stop", "rl"),
    ]
    for name in ("world", "planner", "fallback"):
        assert set(gone[f"first {name}"]) == set(gone[f"second {name}"]) == {WHAT[name]}
    assert len(after["differences"]) == len(before) - 2


def test_a_row_that_was_run_again_with_the_same_numbers_keeps_its_differences(out, after, tmp_path):
    before = read_tables(out / "tables")["differences"]
    write_tables(tmp_path / "tables", {**after, "differences": before})
    shutil.copytree(out / "runs", tmp_path / "runs")
    assert update_tables(GRID, tmp_path)["differences"].equals(before)


def test_results_of_one_seed_are_read_again(after, tmp_path):
    write_tables(tmp_path / "one", after)
    write_tables(tmp_path / "two", read_tables(tmp_path / "one"))
    for path in (tmp_path / "one").iterdir():
        assert path.read_bytes() == (tmp_path / "two" / path.name).read_bytes()


def test_the_new_rows_tell_what_the_episode_did(after):
    success = after["success"].filter(**SUBJECT).row(0, named=True)
    assert (success["episodes"], success["train_seeds"]) == (1, 1)
    placed = after["kinds"].filter(**SUBJECT)["placements"].sum()
    assert 0 < placed <= after["hand-overs"].filter(**SUBJECT)["count"].sum()  # an object may be placed again
    stages = after["stages"].filter(**SUBJECT, counting="latched")
    assert stages["mean"][-1] == success["latched mean"]
    assert after["outcomes"].filter(**SUBJECT)["count"].sum() == 1


def test_the_four_counts_of_new_rows_are_counted_and_shown(after):
    (row,) = after["counts"].filter(**SUBJECT).to_dicts()
    (success,) = after["success"].filter(**SUBJECT).to_dicts()
    assert (row["episodes"], row["stays mean"]) == (1, success["stabilizing mean"])
    assert row["all_four mean"] == min(row[f"{name} mean"] for name in ("stays", "upright", "undisturbed", "soft"))
    alone = after["counts"].filter(**SUBJECT).with_columns(world=pl.lit(""), fallback=pl.lit("none"))
    usual = {**after, "counts": alone}
    (shown,) = PAGE_TABLES["counts"](usual).to_dicts()
    assert (shown["release"], shown["planner"], shown["fallback"]) == ("`stop`", "closed", "none")
    assert shown["oracle took over"] == f"{row['taken_over']} of 1"


def test_release_speeds_count_every_placement(after):
    counts = after["release-speed"]
    assert counts["placements"].sum() == after["kinds"].filter(**SUBJECT)["placements"].sum()
    assert counts["hand_over"].all()
    assert list(speed_figures(counts)) == []  # all of them hand-overs
