"""The committed tables: the analysis makes them again, sentences about them hold, damaged ones are refused."""

import shutil
from pathlib import Path

import polars as pl
import pytest
from scipy import stats

from perdure.errors import PerdureError
from studies.files import read_csv
from studies.placement import study
from studies.placement.tables import COLUMNS, OPTIONAL, PAGE_TABLES, read_tables

ROOT = Path(__file__).parents[3]
COMMITTED = ROOT / "results" / "placement"


@pytest.fixture(scope="module")
def tables():
    return read_tables(COMMITTED / "tables")


@pytest.fixture(scope="module")
def again(tmp_path_factory):
    """The results made again from the tables and the page alone."""
    out = tmp_path_factory.mktemp("placement")
    shutil.copytree(COMMITTED / "tables", out / "tables")
    shutil.copy(COMMITTED / "README.md", out)
    study.analyze("thesis", out)
    return out


def test_the_analysis_writes_the_same_files_again(again):
    for folder in ("tables", "figures"):
        assert {path.name for path in (again / folder).iterdir()} == {
            path.name for path in (COMMITTED / folder).iterdir()
        }
    for path in [again / "README.md", *(again / "tables").iterdir()]:
        assert path.read_bytes() == (COMMITTED / path.relative_to(again)).read_bytes(), path.name


def test_every_table_of_the_page_is_one_of_the_study_and_not_empty(tables):
    assert all(make(tables).height > 0 for make in PAGE_TABLES.values())
    drag = PAGE_TABLES["worlds"](tables).filter(world="drag only")
    assert dict(drag.select("task", "`rl`").iter_rows()) == {
        "SetTable": "18.6 % [0, 43]",
        "TidyHouse": "44.9 % [15, 75]",
        "PrepareGroceries": "49.0 % [29, 69]",
    }


def test_counts_fit_together(tables):
    keys = ["task", "split", "strategy"]
    totals = tables["success"].select(*keys, "episodes", "did_not_last", latched=pl.col("latched mean"))
    counts = (
        tables["outcomes"]
        .group_by(keys)
        .agg(
            pl.col("count").sum().alias("all"),
            pl.col("count").filter(pl.col("outcome").str.starts_with("success")).sum().alias("succeeded"),
        )
    )
    both = totals.join(counts, on=keys)
    assert len(both) == len(totals)
    assert (both["all"] == both["episodes"]).all()
    assert ((both["succeeded"] / both["episodes"] - both["latched"]).abs() < 1e-4).all()
    failed = tables["modes"].group_by(keys).agg(pl.col("count").sum().alias("failed"))
    shares = tables["success"].join(failed, on=keys, how="left").with_columns(pl.col("failed").fill_null(0))
    assert ((1 - shares["failed"] / shares["episodes"] - shares["stabilizing mean"]).abs() < 1e-4).all()


def test_after_holm_no_gain_with_drag_only_would_be_below_5_percent(tables):
    """Six paired differences of three policy sets each; the p value follows from the lower bound (Student t)."""
    found = tables["differences"].filter(
        pl.col("second").is_in(["stop drag", "ik drag"]), split="eval", first="rl drag"
    )
    estimate, lower = (found[f"episodes {name}"].to_numpy() for name in ("estimate", "lower"))
    error = (estimate - lower) / stats.t.ppf(0.975, 2)
    p = sorted(2 * stats.t.sf(estimate / error, 2))
    assert len(p) == 6
    assert (lower > 0).all()
    assert max(p) < 0.05 < 6 * min(p)


@pytest.mark.parametrize("second", ["stop", "ik"])
def test_success_rises_in_each_policy_set_of_each_task(tables, second):
    for task in ("set_table", "tidy_house", "prepare_groceries"):
        alone, stopped = (
            tables["seeds"].filter(task=task, split="eval", strategy=f"{name} drag")["stabilizing"]
            for name in ("rl", second)
        )
        assert len(alone) == 3
        assert (stopped > alone).all()


EDITS = {
    "wrong column": (
        "release-speed",
        ("interval,hand_over,", "interval,moves,"),
        r"release-speed\.csv: its columns must be interval, hand_over, .*, not interval, moves",
    ),
    "wrong type": (
        "release-speed",
        ("apples,16,", "apples,many,"),
        r"release-speed\.csv is no readable CSV: could not parse `many` as dtype `i64` at column 'placements'",
    ),
    "missing value": ("release-speed", ("apples,16,", "apples,,"), r"release-speed\.csv: row \d+ has no placements"),
    "too many values": (
        "release-speed",
        ("0.99,\n", "0.99,,5\n"),
        r"release-speed\.csv is no readable CSV: found more",
    ),
    "cut line": (
        "release-speed",
        (None, "interval,hand"),
        r"release-speed\.csv: its columns must be interval, hand_over",
    ),
}


@pytest.mark.parametrize(("name", "edit", "message"), EDITS.values(), ids=EDITS)
def test_a_wrong_csv_is_refused(tmp_path, name, edit, message):
    shutil.copytree(COMMITTED / "tables", tmp_path / "tables")
    path, (old, new) = tmp_path / "tables" / f"{name}.csv", edit
    text = path.read_text()
    assert old is None or old in text
    path.write_text(text.replace(text if old is None else old, new, 1))
    with pytest.raises(PerdureError, match=message):
        read_tables(tmp_path / "tables")


def test_a_csv_cut_within_a_row_is_refused(tmp_path):
    whole, path = (COMMITTED / "tables" / "release-speed.csv").read_bytes(), tmp_path / "cut.csv"
    rows = []
    for size in range(len(whole) + 1):
        path.write_bytes(whole[:size])
        if whole[:size].endswith(b"\n"):
            rows.append(len(read_csv(path, COLUMNS["release-speed"], OPTIONAL)))
            continue
        with pytest.raises(PerdureError, match=r"cut\.csv"):
            read_csv(path, COLUMNS["release-speed"], OPTIONAL)
    assert rows == list(range(whole.count(b"\n")))
