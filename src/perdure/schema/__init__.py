"""Declare what each kind of file may contain, and check it when a file is read.

    kinds.py      kinds of values: Text, Whole, Real, Flag, Choice, Items, Maybe, Table, Anything
    columns.py    the same kinds checked over the columns of a Polars table
    strict.py     read JSON; any fault is a SchemaError
    parquet.py    read Parquet with Polars; any fault is a SchemaError
    decoder.py    the separate process in which Parquet is decoded first
    text.py       text for a terminal: without control characters
    errors.py     SchemaError

A reader declares a `Table` and converts a SchemaError to its own error, with the file's name. The package imports no
other part of perdure.
"""

from perdure.schema.columns import check_columns
from perdure.schema.errors import SchemaError
from perdure.schema.kinds import LARGEST, Anything, Choice, Flag, Items, Kind, Maybe, Real, Rule, Table, Text, Whole
from perdure.schema.parquet import Parquet
from perdure.schema.strict import read_json
from perdure.schema.text import printable

__all__ = [
    "LARGEST",
    "Anything",
    "Choice",
    "Flag",
    "Items",
    "Kind",
    "Maybe",
    "Parquet",
    "Real",
    "Rule",
    "SchemaError",
    "Table",
    "Text",
    "Whole",
    "check_columns",
    "printable",
    "read_json",
]
