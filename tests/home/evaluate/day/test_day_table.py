"""The table of days: what it refuses, and what its columns measure."""

import numpy as np
import polars as pl
import pytest
from home_days import make_day

from perdure.errors import PerdureError
from perdure.home.evaluate import day_table
from perdure.home.evaluate.day_table import COLUMNS, _longest_stand, describe_columns, read_days, to_frame, write_days


def test_what_is_written_is_read(tmp_path):
    frame = to_frame(make_day() + make_day(home=1))
    path = write_days(tmp_path / "day.parquet", frame, {"command": "a test"})
    again, notes = read_days(path)
    assert again.equals(frame)
    assert notes == {"command": "a test"}
    assert [name for name, _, _ in describe_columns()] == list(COLUMNS) == frame.columns


@pytest.mark.parametrize(
    ("word", "change"),
    [
        ("twice", {"errand": pl.lit(1, pl.Int64)}),
        ("then", {"then": pl.lit("sleeps")}),
        ("on_floor", {"on_floor": pl.lit(-1, pl.Int64)}),
        ("before it begins", {"end": pl.lit(0.0)}),
        ("more targets", {"tipped_targets": pl.lit(6, pl.Int64)}),
        ("columns", {"mood": pl.lit(1, pl.Int64)}),
    ],
)
def test_what_does_not_fit_is_refused(tmp_path, word, change):
    with pytest.raises(PerdureError, match=word):
        write_days(tmp_path / "day.parquet", to_frame(make_day()).with_columns(**change), {})
    assert not list(tmp_path.iterdir())


def test_a_table_of_version_1_is_of_the_earlier_physics(tmp_path, monkeypatch):
    frame = to_frame(make_day())
    monkeypatch.setattr(day_table, "SCHEMA_VERSION", "1")
    monkeypatch.setattr(day_table, "check_days", lambda *_: None)
    path = write_days(tmp_path / "day.parquet", frame.drop("disturbance"), {})
    monkeypatch.undo()
    again, _ = read_days(path)
    assert again.drop("world").equals(frame.drop("world"))
    assert set(again["world"]) == {"snapped grasp, base 3 m per s"}


def test_a_damaged_or_foreign_file_is_refused(tmp_path):
    path = write_days(tmp_path / "day.parquet", to_frame(make_day()), {})
    foreign = tmp_path / "foreign.parquet"
    to_frame(make_day()).write_parquet(foreign)
    with pytest.raises(PerdureError, match="schema"):
        read_days(foreign)
    changed = tmp_path / "changed.parquet"
    frame = pl.read_parquet(path)
    notes = pl.read_parquet_metadata(path)
    frame.with_columns(on_floor=pl.lit(1, pl.Int64)).write_parquet(
        changed, metadata={name: text for name, text in notes.items() if name != "ARROW:schema"}
    )
    with pytest.raises(PerdureError, match="SHA-256"):
        read_days(changed)
    with pytest.raises(PerdureError, match="does not exist"):
        read_days(tmp_path / "nothing.parquet")


def test_a_robot_stands_until_it_leaves_or_a_skill_succeeds():
    drives = np.linspace([0.0, 0.0], [10.0, 0.0], 51)
    stands = np.repeat(drives[-1:], 20, axis=0)
    assert _longest_stand(drives, set()) == 0
    assert _longest_stand(np.concatenate([drives, stands]), set()) == 20
    assert _longest_stand(np.concatenate([drives, stands]), {60}) == 10
    sways = stands + 0.04 * np.sin(np.arange(20.0))[:, None]
    assert _longest_stand(sways, set()) == 19
