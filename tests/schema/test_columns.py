"""Rules between the columns of a table."""

import polars as pl
import pytest

from perdure.schema import SchemaError, check_columns
from perdure.schema.kinds import Real, Rule, Table

TABLE = Table(
    {"low": Real(0.0), "high": Real(0.0, infinite=True)},
    rules=(
        Rule("low lies above high", lambda of: of("low") > of("high")),
        Rule("high is too large", lambda of: of("high").is_finite() & (of("high") > 9)),  # names a column twice
    ),
)


def check(low, high):
    check_columns(pl.DataFrame({"low": low, "high": high}).get_column, TABLE)


def test_rows_that_keep_every_rule_pass():
    check([1.0, 2.0], [1.0, float("inf")])


@pytest.mark.parametrize(
    ("high", "row", "rule"), [([1.0, 1.0], 1, "low lies above high"), ([10.0, 2.0], 0, "too large")]
)
def test_the_first_row_that_breaks_a_rule_is_named(high, row, rule):
    with pytest.raises(SchemaError, match=rf"row {row}: .*{rule}"):
        check([1.0, 2.0], high)
