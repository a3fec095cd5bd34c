"""Damaged tables are refused: the message names the file, the field and what is allowed."""

import json
import shutil
from pathlib import Path

import pytest

from perdure.studies import StudyError
from perdure.studies.files import read_csv
from perdure.studies.placement.release_speed import SCHEMA
from perdure.studies.placement.tables import read_tables

COMMITTED = Path(__file__).parents[3] / "results" / "placement" / "tables"


@pytest.fixture
def out(tmp_path):
    """A folder of results with the committed tables."""
    shutil.copytree(COMMITTED, tmp_path / "tables")
    return tmp_path


def replace_text(path, old, new):
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))


def remove(row, *names):
    for name in names[:-1]:
        row = row[name]
    del row[names[-1]]


def test_the_committed_tables_are_read(out):
    tables = read_tables(out)
    frames = {"release-speed": tables.speeds, "hand-over": tables.hand_over, "halt-in-noise": tables.noise}
    for name, frame in frames.items():
        assert len(frame) == (COMMITTED / f"{name}.csv").read_text().count("\n") - 1 > 0
    text = (COMMITTED / "strategies.json").read_text()
    assert len(tables.results.rows) == text.count('"stages":') > 0
    assert len(tables.results.pairs) == text.count('"second":') > 0


def test_a_cut_file_is_refused(out):
    path = out / "tables" / "strategies.json"
    path.write_text(path.read_text()[:5000])
    with pytest.raises(StudyError, match=r"tables/strategies\.json: it is not readable JSON: .* line \d+ column"):
        read_tables(out)


EDITS = {
    "missing field": (lambda row: remove(row, "episodes"), r"rows\[3\] has no episodes"),
    "missing part": (lambda row: remove(row, "latched", "lower"), r"rows\[3\]\.latched has no lower"),
    "unknown task": (
        lambda row: row.update(task="set_tabel"),
        r"rows\[3\]\.task must be one of 'set_table', 'tidy_house', 'prepare_groceries', not 'set_tabel'",
    ),
    "unknown strategy": (
        lambda row: row.update(strategy="throw drag"),
        r"the strategy in rows\[3\]\.strategy must be one of 'rl', 'delta-10', .*, 'ik\+', not 'throw'",
    ),
    "unknown world": (
        lambda row: row.update(strategy="ik mud"),
        r"the world in rows\[3\]\.strategy must be one of 'drag', .*, not 'mud'",
    ),
    "unknown object": (
        lambda row: row["kinds"].update({"024_bowls": row["kinds"]["024_bowl"]}),
        r"'rows\[3\]\.kinds\.024_bowls' is no field of .*did you mean 024_bowl\?",
    ),
    "text for a count": (
        lambda row: row.update(failed="13"),
        r"rows\[3\]\.failed must be a whole number from 0 to \d+, not '13'",
    ),
    "share above 1": (
        lambda row: row["stabilizing"].update(mean=18.6),
        r"rows\[3\]\.stabilizing\.mean must be a number from 0 to 1, not 18\.6",
    ),
    "missing stage": (
        lambda row: remove(row, "stages", "latched", "pick_0"),
        r"rows\[3\]: stages must be all stages of the task, in order",
    ),
}


@pytest.mark.parametrize(("edit", "message"), EDITS.values(), ids=EDITS)
def test_a_wrong_row_is_refused(out, edit, message):
    path = out / "tables" / "strategies.json"
    values = json.loads(path.read_text())
    edit(values["rows"][3])
    path.write_text(json.dumps(values))
    with pytest.raises(StudyError, match=rf"tables/strategies\.json: {message}"):
        read_tables(out)


def test_a_wrong_pair_is_refused(out):
    replace_text(out / "tables" / "strategies.json", '"first": "rl"', '"first": "lr"')
    with pytest.raises(StudyError, match=r"pairs\[0\]\.first must be one of 'rl', .*, not 'lr'"):
        read_tables(out)


CSV_EDITS = {
    "wrong column": (
        "hand-over",
        ("descent,speed,", "descent,velocity,"),
        r"hand-over\.csv: its columns must be descent, speed, placements, .*, not descent, velocity, placements",
    ),
    "wrong type": (
        "hand-over",
        ("0.0,0.15,188,", "0.0,0.15,many,"),
        r"hand-over\.csv is no readable CSV: could not parse `many` as dtype `i64` at column 'placements'",
    ),
    "missing value": ("halt-in-noise", ("arm,186,", "arm,,"), r"halt-in-noise\.csv: row 0 has no commanded"),
    "too many values": (
        "release-speed",
        ("0.99,\n", "0.99,,5\n"),
        r"release-speed\.csv is no readable CSV: found more",
    ),
    "no columns": ("release-speed", (None, ""), r"release-speed\.csv is no readable CSV: empty CSV"),
    "cut line": (
        "release-speed",
        (None, "interval,in_m"),
        r"release-speed\.csv: its columns must be interval, in_motion",
    ),
}


@pytest.mark.parametrize(("name", "edit", "message"), CSV_EDITS.values(), ids=CSV_EDITS)
def test_a_wrong_csv_is_refused(out, name, edit, message):
    path, (old, new) = out / "tables" / f"{name}.csv", edit
    replace_text(path, path.read_text() if old is None else old, new)
    with pytest.raises(StudyError, match=message):
        read_tables(out)


def test_a_csv_cut_within_a_row_is_refused(tmp_path):
    whole, path = (COMMITTED / "release-speed.csv").read_bytes(), tmp_path / "cut.csv"
    rows = []
    for size in range(len(whole) + 1):
        path.write_bytes(whole[:size])
        if whole[:size].endswith(b"\n"):
            rows.append(len(read_csv(path, SCHEMA, optional=("median_speed",))))
            continue
        with pytest.raises(StudyError, match=r"cut\.csv"):
            read_csv(path, SCHEMA, optional=("median_speed",))
    assert rows == list(range(whole.count(b"\n")))
