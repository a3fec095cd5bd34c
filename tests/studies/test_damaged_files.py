"""A file that is damaged is refused: the message names it."""

import polars as pl
import pytest

from perdure.errors import PerdureError
from studies.files import include_tables, read_parquet_file, write_csv
from studies.horizon.results import CLOCKS


def test_a_cut_parquet_file(tmp_path):
    path = tmp_path / "left.parquet"
    pl.DataFrame({"a": list(range(1000))}).write_parquet(path)
    path.write_bytes(path.read_bytes()[:-20])
    with pytest.raises(PerdureError, match=r"left\.parquet: it is not a readable Parquet file"):
        read_parquet_file(path)


def test_a_frozen_table_of_other_columns(tmp_path):
    assert CLOCKS.read(tmp_path).is_empty()
    pl.DataFrame({"a": [1]}).write_parquet(tmp_path / "clocks.parquet")
    with pytest.raises(PerdureError, match=r"clocks\.parquet: its columns must be setting, method, rule"):
        CLOCKS.read(tmp_path)


def test_new_rows_replace_those_of_their_key(tmp_path):
    def rows(clock, *seeds):
        common = {"setting": "Hopper-v3", "method": "geometric", "rule": "bandit", "simulated_steps": 1}
        return pl.DataFrame([{**common, "train_seed": seed, "clock": clock} for seed in seeds])

    CLOCKS.add(tmp_path, rows("constant:100", 1, 0))
    CLOCKS.add(tmp_path, rows("constant:300", 1, 2))
    assert CLOCKS.read(tmp_path).select("train_seed", "clock").sort("train_seed").rows() == [
        (0, "constant:100"),
        (1, "constant:300"),
        (2, "constant:300"),
    ]


def test_tables_have_six_digits_and_empty_cells(tmp_path):
    path = write_csv(tmp_path / "x.csv", pl.DataFrame({"a": [1.23456789, float("nan"), None], "b": [1, 2, 3]}))
    assert path.read_text() == "a,b\n1.23457,1\n,2\n,3\n"


def test_a_page_includes_tables_between_marks(tmp_path):
    page = tmp_path / "README.md"
    page.write_text("Before.\n<!-- table: a -->\nold\n<!-- end -->\nAfter.\n")
    for _ in range(2):
        include_tables(page, {"a": pl.DataFrame({"x": ["1", "2"], "y": ["3", ""]})})
        table = "| x | y |\n| --- | --- |\n| 1 | 3 |\n| 2 |  |"
        assert page.read_text() == f"Before.\n<!-- table: a -->\n\n{table}\n\n<!-- end -->\nAfter.\n"
    with pytest.raises(PerdureError, match="includes the table 'a'; there are b"):
        include_tables(page, {"b": pl.DataFrame({"x": ["1"]})})
