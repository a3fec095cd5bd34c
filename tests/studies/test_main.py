"""`python -m studies` says in one line what is wrong, and shows how far a study is."""

import shutil
from pathlib import Path

import pytest

from perdure.runs import Store, Unit, attempt
from studies.__main__ import main, status_text
from studies.placement import study

RESULTS = Path(__file__).parents[2] / "results"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["horizon", "--scale", "smok"], "study horizon has no scale 'smok'; its scales are smoke, laptop, thesis"),
        (["disturbance", "--scale", "thesis", "--phases", "1", "7"], "has no phase 7; its phases are [1, 2, 3]"),
        (["horizon", "--on", "cloud"], "here, local, ray or ray:ADDRESS"),
        (["horizon", "--analyze-only", "--out", "none"], "there are no results of the study horizon in none"),
        (["horizon", "--collect", "none", "--out", "out"], "there is no finished training run in none"),
        (["horizon", "--out", "file"], "Not a directory: 'file'"),
        (["placement", "--analyze-only", "--out", "none"], "there are no results of the study placement in none"),
        (["placement", "--collect", "none"], "--collect belongs to the study horizon"),
    ],
)
def test_a_mistake_ends_in_one_line(arguments, words, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("file").touch()
    with pytest.raises(SystemExit) as end:
        main(arguments)
    assert end.value.code == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("studies: ")
    assert words in line


def test_a_page_that_is_not_of_the_study_is_not_touched(tmp_path, capsys):
    shutil.copytree(RESULTS / "placement" / "tables", tmp_path / "tables")
    (tmp_path / "README.md").write_text("mine")
    with pytest.raises(SystemExit):
        main(["placement", "--scale", "thesis", "--analyze-only", "--out", str(tmp_path)])
    assert "is not a page of the study, it includes no table" in capsys.readouterr().err
    assert (tmp_path / "README.md").read_text() == "mine"


def half(work):
    """Report progress and leave the unit unfinished."""
    work.report(1, 2)
    return False


def whole(work):
    """Finish at once."""


def test_status_counts_units_by_what_they_run(tmp_path):
    units = [
        Unit("a", {}, f"{__name__}:whole"),
        Unit("b", {}, f"{__name__}:whole"),
        Unit("c", {}, f"{__name__}:half", size=3.0),
    ]
    attempt(tmp_path, units[0])
    attempt(tmp_path, units[2])
    lines = status_text(units, Store(tmp_path).root).splitlines()
    assert [" ".join(line.split()) for line in lines] == [
        "whole 1 of 2 done, 0 failed (50% of the work)",
        "half 0 of 1 done, 0 failed (50% of the work)",
    ]


def test_the_status_of_a_study_of_which_only_tables_are_kept_calls_it_finished(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    main(["placement", "--status"])
    assert "0 of 6 done" in capsys.readouterr().out
    monkeypatch.setitem(study.SCALES, "smoke", Path("results", "placement"))
    (tmp_path / "results" / "placement" / "tables").mkdir(parents=True)
    main(["placement", "--status"])
    assert "finished: its tables are kept" in capsys.readouterr().out
