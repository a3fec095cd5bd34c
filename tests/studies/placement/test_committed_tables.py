"""The committed tables: the analysis makes them again, sentences about them hold, damaged ones are refused."""

import re
import shutil
from pathlib import Path

import polars as pl
import pytest

from perdure.errors import PerdureError
from studies.files import read_csv
from studies.placement import study
from studies.placement.grid import GRIDS, RELEASES, TASKS
from studies.placement.tables import COLUMNS, KEYS, OPTIONAL, PAGE_TABLES, read_tables

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
    named = re.findall(r"<!-- table: (\S+) -->", (COMMITTED / "README.md").read_text())
    assert all(PAGE_TABLES[name](tables).height > 0 for name in named)
    first = PAGE_TABLES["tasks"](tables).row(0, named=True)
    assert (first["task"], first["release"], first["open"]) == ("SetTable", "`rl`", "92.8 % [92, 94]")


def test_counts_fit_together(tables):
    keys = list(KEYS)
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


def test_what_the_answer_says_holds(tables):
    """Planning again wins in every task; how the hand opens decides where only drag slows a rolling object."""
    success = tables["success"].filter(split="eval")
    usual = {"place": "rl", "world": ""}
    closed_loop = {"planner": "closed", "fallback": "oracle"}

    def row(task, place="rl", world="", planner="closed", fallback="oracle"):
        what = {"place": place, "world": world, "planner": planner, "fallback": fallback}
        return success.filter(task=task, **what).row(0, named=True)

    for task in TASKS:
        opened, closed = row(task, planner="open", fallback="none"), row(task)
        unseen = tables["success"].filter(task=task, split="eval-2", **usual, **closed_loop).row(0, named=True)
        pair = {"first place": "rl", "first planner": "open", "second place": "rl", "second planner": "closed"}
        same = {"first world": "", "second world": "", "second fallback": "oracle"}
        (gain,) = tables["differences"].filter(task=task, split="eval", **pair, **same).to_dicts()
        assert gain["episodes lower"] > 0.0
        assert gain["episodes estimate"] == pytest.approx(
            closed["stabilizing mean"] - opened["stabilizing mean"], abs=1e-6
        )
        assert closed["stabilizing mean"] >= 0.97
        assert closed["unaided"] >= 0.93 * closed["episodes"]
        assert abs(closed["stabilizing mean"] - unseen["stabilizing mean"]) <= 0.03
    unseen_split = pl.col("split").str.starts_with("eval")
    unaided = tables["success"].filter(unseen_split, **usual, **closed_loop)
    shares = unaided["unaided"] / unaided["episodes"]
    closed = pl.Series([row(task)["stabilizing mean"] for task in TASKS])
    opened = pl.Series([row(task, planner="open", fallback="none")["stabilizing mean"] for task in TASKS])
    drag = pl.Series([row("set_table", place, "drag only")["stabilizing mean"] for place in ("rl", "stop")])
    rolling = PAGE_TABLES["rolling"](tables).filter(task="SetTable")
    before, after = (rolling.filter(release=f"`{place}`")["0 mm"][0] for place in ("rl", "stop"))
    assert ("[52, 100]" in before, "[93, 100]" in after) == (True, True)
    alone = pl.Series([float(each.partition("; ")[2].removesuffix(" %")) / 100 for each in (before, after)])
    others = pl.Series([row(task, place)["stabilizing mean"] for task in TASKS for place in RELEASES[1:]])
    for page, said, found in (
        ("README.md", "Every object stays in {:.0f} to {:.0f} % of the episodes with one plan", opened),
        ("docs/home/index.md", "took over no skill and all are in place at the end in {:.0f} to {:.0f} %", shares),
        (
            "docs/home/index.md",
            "{:.0f} % [52, 100] of 150 episodes if the hand opens in motion, and in {:.0f} % [93, 100] if",
            drag,
        ),
        (
            "results/placement/README.md",
            "{:.0f} % [52, 100] of 150 episodes if the policy lets go in motion, and in {:.0f} % [93,",
            drag,
        ),
        ("docs/home/index.md", "other releases: {:.0f} to {:.0f} %", others),
        ("docs/home/index.md", "(closed loop with oracle; unaided {:.0f} % and {:.0f} %)", alone),
        ("results/placement/README.md", "(closed loop with oracle; unaided {:.0f} % and {:.0f} %;", alone),
        ("results/placement/README.md", "with one plan for the whole task in {:.0f} to {:.0f} %", opened),
    ):
        words = said.format(100 * found.min(), 100 * found.max())
        assert words in " ".join((ROOT / page).read_text().split())
    assert closed.min() >= 0.99
    (stopped,) = (
        tables["differences"]
        .filter(task="set_table", split="eval", **{"first place": "rl", "second place": "stop"})
        .filter(**{"first world": "drag only", "first planner": "closed", "first fallback": "oracle"})
        .to_dicts()
    )
    assert stopped["episodes lower"] > 0.0
    assert (success.filter(place="gentle")["stabilizing mean"] >= 0.8).all()
    assert len(success.filter(place="gentle")) == sum(each.place == "gentle" for each in GRIDS["thesis"])


@pytest.mark.parametrize("page", ["README.md", "docs/home/index.md", "results/placement/README.md"])
def test_pages_begin_with_success_as_a_person_means_it(tables, page):
    """All four counts, without fallback."""
    rows = tables["counts"].filter(place="rl", planner="closed", fallback="none", split="eval", world="")
    assert rows["episodes"].to_list() == [900, 900, 900]
    words = " ".join((ROOT / page).read_text().split())
    low, high = 100 * rows["stays mean"].min(), 100 * rows["stays mean"].max()
    assert re.search(f"stays in {low:.0f} to {high:.0f} % of the|stays in {low:.0f} to {high:.0f} %:", words)
    (table,) = rows.filter(task="set_table").to_dicts()
    mean, lower, upper = (100 * table[f"all_four {bound}"] for bound in ("mean", "lower", "upper"))
    assert f"a person would accept {mean:.0f} % [{lower:.0f}, {upper:.0f}] of SetTable's" in words.replace(
        "A person", "a person"
    )
    assert rows.filter(pl.col("task") != "set_table")["all_four mean"].to_list() == [0.0, 0.0]


def test_what_pages_say_of_bowls_and_of_release_speeds(tables):
    what = {"place": "rl", "world": "", "planner": "closed", "fallback": "oracle", "kind": "024_bowl"}
    bowls = tables["kinds"].filter(task="set_table", split="eval", **what).row(0, named=True)
    home, page = (
        " ".join((ROOT / name).read_text().split()) for name in ("docs/home/index.md", "results/placement/README.md")
    )
    assert f"Half of the {bowls['placements']} bowls of SetTable are let go tilted by more than 115 degrees" in home
    assert f"let go tilted by {bowls['tilt']:.0f} degrees (`rl`, closed loop, {bowls['placements']} placements" in page
    slow = tables["release-speed"].filter(interval=0)
    stayed = {
        (hand_over, objects): f"{100 * share:.0f} % of {count:,} {objects}"
        for hand_over, objects, count, share in slow.drop("interval", "median_speed").iter_rows()
    }
    assert f"Below 0.02 m/s {stayed[False, 'apples']} and {stayed[False, 'bowls']} stay" in page
    assert f"after a hand-over {stayed[True, 'bowls']} and {stayed[True, 'cans']}" in page


EDITS = {
    "wrong column": (
        "release-speed",
        ("interval,hand_over,", "interval,moves,"),
        r"release-speed\.csv: its columns must be interval, hand_over, .*, not interval, moves",
    ),
    "wrong type": (
        "release-speed",
        ("apples,64,", "apples,many,"),
        r"release-speed\.csv is no readable CSV: could not parse `many` as dtype `i64` at column 'placements'",
    ),
    "missing value": ("release-speed", ("apples,64,", "apples,,"), r"release-speed\.csv: row \d+ has no placements"),
    "too many values": (
        "release-speed",
        ("0.00809924\n", "0.00809924,,5\n"),
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
