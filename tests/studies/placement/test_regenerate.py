"""The analysis makes every committed table, figure and page again from the committed tables, byte for byte."""

import importlib.util
import shutil
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from perdure.report.render import render
from perdure.studies import find_study
from perdure.studies.placement.grid import make_grid
from perdure.studies.placement.page import result_text, write_page
from perdure.studies.placement.results import Results, chosen
from perdure.studies.placement.tables import read_tables

ROOT = Path(__file__).parents[3]
COMMITTED = ROOT / "results" / "placement"
SOURCES = ("strategies.json", "release-speed.csv", "hand-over.csv", "halt-in-noise.csv")
"""Tables that logs make; everything else is made from them."""


@pytest.fixture(scope="module")
def again(tmp_path_factory):
    """The results made again from the sources alone."""
    out = tmp_path_factory.mktemp("placement")
    (out / "tables").mkdir()
    for name in SOURCES:
        shutil.copy(COMMITTED / "tables" / name, out / "tables")
    study = find_study("placement")
    study.analyze("thesis", out)
    return out


def files(folder):
    return {
        path.relative_to(folder): path
        for path in sorted(folder.rglob("*"))
        if path.is_file() and "runs" not in path.relative_to(folder).parts
    }


def test_the_same_files_with_the_same_bytes(again):
    made, committed = files(again), files(COMMITTED)
    assert set(made) == set(committed)
    assert [str(name) for name in made if made[name].read_bytes() != committed[name].read_bytes()] == []


def test_another_number_gives_another_result():
    results = read_tables(COMMITTED).results
    assert "from 18.6 % to 82.1 % in SetTable" in result_text(results)
    row = next(row for row in chosen(results.rows, "eval", "drag", "set_table") if row["strategy"] == "rl drag")
    changed = {**row, "stabilizing": {**row["stabilizing"], "mean": 0.5}}
    assert "from 50.0 % to 82.1 % in SetTable" in result_text(results.merge([], [changed], []))


def test_rows_of_an_earlier_run_are_counted_until_logs_replace_them(tmp_path):
    tables = read_tables(COMMITTED)
    new = [{name: value for name, value in row.items() if name != "earlier_run"} for row in tables.results.rows]
    old = [{**row, "earlier_run": True} for row in new]
    pages = [
        write_page(
            tmp_path / "README.md",
            make_grid("thesis", (1,)),
            replace(tables, results=Results(rows=tuple(old)).merge([], rows, [])),
            [],
        ).read_text()
        for rows in ([], new[1:], new)
    ]
    assert f"{len(new)} of {len(new)} rows keep numbers of an earlier run" in pages[0]
    assert f"1 of {len(new)} rows keep numbers of an earlier run" in pages[1]
    assert "earlier run" not in pages[2]


@pytest.fixture
def tool(monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "tools")
    spec = importlib.util.spec_from_file_location("home_tables", ROOT / "tools" / "home_tables.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    yield module
    sys.modules.pop("marks", None)


def test_the_documentation_holds_the_tables(tool):
    for page, tables in tool.tables_by_page(read_tables(COMMITTED)).items():
        text = (ROOT / page).read_text()
        assert tool.filled(text, tables) == text


@pytest.mark.parametrize("name", ["home-release-strategies.png", "home-release-speed.png"])
def test_the_documentation_holds_the_picture(tool, name):
    drawn = tool.pictures(read_tables(COMMITTED))
    assert set(drawn) == set(tool.PICTURES.values())
    assert render(drawn[name]) == (ROOT / "docs" / "images" / name).read_bytes()


def test_a_page_without_marks_is_refused(tool):
    with pytest.raises(SystemExit, match="lacks the marks"):
        tool.filled("no table here", {"headline": "| a |"})
