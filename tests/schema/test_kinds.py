"""Each kind takes what it says and nothing else, alike in a value, in a list and in a column; damaged files."""

import io
import math

import polars as pl
import pytest

from perdure.errors import PerdureError
from perdure.schema import (
    Choice,
    Flag,
    Items,
    Maybe,
    Parquet,
    Real,
    Rule,
    Table,
    Text,
    Whole,
    check_columns,
    printable,
    read_json,
)

INF, NAN = math.inf, math.nan
CASES = [
    (Text(3), pl.String, ["", "abc", "äöü"], ["abcd", "a\x1b", "\u202e", "a\nb"]),
    (Text(3, shortest=1), pl.String, ["a"], ["", "abcd"]),
    (Whole(0, 9), pl.Int64, [0, 9], [-1, 10]),
    (Real(0.0, 1.0), pl.Float64, [0.0, 1.0], [-1e-9, 1.1, NAN, INF, -INF]),
    (Real(0.0, 1.0, above=True), pl.Float64, [1e-9], [0.0, NAN]),
    (Real(0.0, infinite=True), pl.Float64, [0.0, INF], [-INF, NAN]),
    (Choice(("a", "b")), pl.String, ["a"], ["c", ""]),
    (Flag(), pl.Boolean, [True, False], []),
]


def takes(check, *arguments):
    try:
        check(*arguments)
    except PerdureError:
        return False
    return True


@pytest.mark.parametrize(
    ("kind", "dtype", "good", "bad"), CASES, ids=lambda each: str(getattr(each, "allowed", each))[:30]
)
def test_a_kind_takes_the_same_as_a_value_in_a_list_and_in_a_column(kind, dtype, good, bad):
    for value, expected in [*((value, True) for value in good), *((value, False) for value in bad)]:
        assert takes(kind.check, value, "x") is expected, value
        assert takes(Items(kind).check, [good[0], value], "x") is expected, value
        frame = pl.DataFrame({"x": [good[0], value]}, schema={"x": dtype})
        assert takes(check_columns, frame.get_column, Table({"x": kind})) is expected, value


@pytest.mark.parametrize("kind", [Text(), Whole(), Real(), Choice(("a",)), Flag(), Items(Text()), Table({})])
@pytest.mark.parametrize("value", [None, "1", 1, 1.5, True, [], {}, [None], b"1"])
def test_values_of_another_type_are_refused(kind, value):
    own = {Text: str, Whole: int, Real: (int, float), Choice: (), Flag: bool, Items: list, Table: dict}[type(kind)]
    expected = isinstance(value, own) and not (isinstance(value, bool) and not isinstance(kind, Flag))
    assert takes(kind.check, value, "x") is (expected and value != [None])


@pytest.mark.parametrize("values", [[None], ["1"], [True], [[1.0]], [10**400], [{}]])
def test_lists_of_numbers_hold_numbers_only(values):
    assert not takes(Items(Real()).check, values, "x")


def test_a_table_names_what_is_missing_unknown_or_broken():
    table = Table({"low": Whole(), "high": Whole()}, rules=[Rule("low above high", lambda of: of("low") > of("high"))])
    table.check({"low": 1, "high": 2})
    for value, said in (
        ({"low": 1}, "it has no high"),
        ({"low": 1, "high": 2, "hihg": 3}, "it must not have the field hihg"),
        ({"low": 1, "high": "2"}, "high must be int, not str"),
        ([], "it must be object, not array"),
    ):
        with pytest.raises(PerdureError, match=said):
            table.check(value)
    with pytest.raises(PerdureError, match="row 1: low above high"):
        check_columns(pl.DataFrame({"low": [1, 3], "high": [2, 2]}).get_column, table)


def test_null_is_allowed_where_it_is_declared():
    assert takes(Maybe(Whole()).check, None, "x")
    assert not takes(Maybe(Whole()).check, "1", "x")
    assert not takes(check_columns, pl.DataFrame({"x": [1, None]}).get_column, Table({"x": Whole()}))


@pytest.mark.parametrize("text", ["[" * 100_000, "1" * 10_000, "{", b"\xff", '{"a": 1,}', ""])
def test_what_is_no_json_is_refused(text):
    with pytest.raises(PerdureError):
        read_json(text)


def test_json_may_be_nested_up_to_a_depth():
    value = 1
    for _ in range(21):
        value = [value]
    assert not takes(read_json, str(value))
    assert takes(read_json, str(value[0]))


def test_printable_text_does_nothing_to_a_terminal():
    assert printable("a\x1b[2Jb\x9bc\n\u202e\ud800 é") == "a\ufffd[2Jb\ufffdc\ufffd\ufffd\ufffd é"
    assert printable("a\n\tb\x07", lines=True) == "a\n\tb\ufffd"


def test_numbers_that_are_not_known_are_nan_in_a_column():
    table = Table({"x": Real(0.0, unknown=True)})
    check_columns(pl.DataFrame({"x": [0.0, NAN]}).get_column, table)
    for wrong in (INF, -1.0, 1e101):
        with pytest.raises(PerdureError, match="row 1: x"):
            check_columns(pl.DataFrame({"x": [0.0, wrong]}).get_column, table)


def test_a_rule_may_name_a_column_twice():
    rule = Rule("high is too large", lambda of: of("high").is_finite() & (of("high") > 9))
    with pytest.raises(PerdureError, match="row 0: high is too large"):
        check_columns(
            pl.DataFrame({"high": [10.0, INF]}).get_column, Table({"high": Real(infinite=True)}, rules=[rule])
        )


def parquet():
    buffer = io.BytesIO()
    pl.DataFrame({"a": [None if k % 7 == 0 else k for k in range(60)]}).write_parquet(buffer, metadata={"note": "text"})
    return buffer.getvalue()


def test_a_parquet_file_is_read_with_its_notes():
    file = Parquet(parquet())
    assert (file.columns, file.notes) == ({"a": pl.Int64}, {"note": "text"})
    assert file.read(["a"])["a"].to_list() == [None if k % 7 == 0 else k for k in range(60)]
    with pytest.raises(PerdureError, match="Parquet"):
        file.read(["b"])


@pytest.mark.parametrize("damage", [lambda whole: b"", lambda whole: whole[:-20], lambda whole: b"PAR1" + whole[30:]])
def test_a_damaged_parquet_file_is_refused_in_one_line(damage):
    with pytest.raises(PerdureError, match=r"^it is not a readable Parquet file: [^\n]*$"):
        Parquet(damage(parquet())).read()
