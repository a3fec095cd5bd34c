"""What a step left is refused if it is damaged: the message names the file."""

import polars as pl
import pytest

from perdure.schema import Items
from perdure.studies import StudyError
from perdure.studies.files import read_json_file, read_parquet_file
from perdure.studies.horizon.mechanism import KNOWN
from perdure.studies.horizon.rules import CHOICES


@pytest.mark.parametrize(
    ("kind", "text", "message"),
    [
        (KNOWN, '{"fall rate": 1.0', "readable JSON"),
        (KNOWN, '{"fall rate": "often"}', "fall rate must be a number"),
        (KNOWN, '{"fall rat": 1.0}', "did you mean fall rate"),
        (CHOICES, '[{"rule": "value"}]', "has no clock"),
        (CHOICES, "{}", "must be a list"),
    ],
)
def test_json(tmp_path, kind, text, message):
    path = tmp_path / "left.json"
    path.write_text(text)
    with pytest.raises(StudyError, match=rf"left\.json: .*{message}"):
        read_json_file(path, kind)


def test_whole_files_are_read(tmp_path):
    (tmp_path / "a.json").write_text('{"fall rate": 1.5}')
    assert read_json_file(tmp_path / "a.json", KNOWN) == {"fall rate": 1.5}
    assert isinstance(CHOICES, Items)
    frame = pl.DataFrame({"a": [1, 2]})
    frame.write_parquet(tmp_path / "a.parquet")
    assert read_parquet_file(tmp_path / "a.parquet").equals(frame)


def test_a_cut_parquet_file(tmp_path):
    path = tmp_path / "left.parquet"
    pl.DataFrame({"a": list(range(1000))}).write_parquet(path)
    path.write_bytes(path.read_bytes()[:-20])
    with pytest.raises(StudyError, match=r"left\.parquet: it is not a readable Parquet file"):
        read_parquet_file(path)
