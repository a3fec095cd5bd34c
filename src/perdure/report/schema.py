"""The table `perdure.extrapolation`, version 2: one row per lane and recorded step, as Parquet.

| column | type | meaning |
|---|---|---|
| policy | text | label of the policy, e.g. its file's stem |
| method | text | how it was trained, e.g. "geometric" |
| task | text | e.g. "Hopper-v3" |
| train_seed | int | seed of the training run |
| train_horizon | float | longest training horizon [steps]; inf: trained without an end; nan: unknown |
| clock | text | the clock of the policy, e.g. "constant(500)"; "none" for a policy without embedding |
| clock_kind | text | "constant", "periodic", "countdown", "none" |
| clock_steps | float | the clock's number, e.g. C = 500; nan where there is none |
| eval_seed | int | start state: the same for every policy and clock of a task |
| test_horizon | int | steps of the lane, unless it ended earlier |
| step | int | a recorded step, > 0 |
| return | float | sum of rewards over the first `step` steps; an ended lane keeps its last value |
| alive | bool | the lane completed `step` steps without ending before |
| end_reason | text | "survived", "terminated", "truncated" or "diverged" |
| end_step | int | steps the lane lasted |
| end_detail | text | what led to the end: sign of divergence, first observation outside its training range; may be "" |
| movement_first | float | movement per step in the first tenth of `test_horizon`, in training standard deviations |
| movement_last | float | likewise in the last tenth; nan for a lane that ended before |
| idle_rate | float | reward per step of an idle robot: the better of zero and random actions |
| reference_rate | float | reward per step of the policy within its training horizon |
| level_rate | float | reward per step of a published policy of the task; nan: none is known |
| window | int | steps of the windows that are judged; 0: none |
| policy_state | text | "worked", "never worked" (within its horizon it gains too little over idle), "cannot tell" |
| policy_note | text | the evidence for that |
| outcome | text | "holds", "decays", "fails silently", "falls", "diverges", "cut" or "unknown" |
| failed_step | int | steps before the failure began; without a failure, all steps of the lane |
| end_hold | float | (rate - idle) / (reference - idle) in the last tenth, or before the lane ended; nan: not known |
| ever_idle | bool | two consecutive windows, at any time, scored below 0.25: hardly better than idle |

Tables of version 1 are read too; they say nothing about idle robots, so their policies are "cannot tell".

A lane is (task, policy, train_seed, clock, eval_seed); all lanes of a task share their recorded steps. The file's
key-value metadata holds `schema`, `version`, a SHA-256 of the content and what the writer adds, such as the `command`.
"""

from __future__ import annotations

import hashlib
import io
import math
import os
from collections.abc import Mapping
from pathlib import Path

import polars as pl

from perdure.report.errors import ReportError
from perdure.report.fields import NOTES, ROW
from perdure.report.lanes import CURVES, Columns, Lanes, split_lanes
from perdure.runs import write_atomic
from perdure.schema import Parquet, SchemaError, check_columns

SCHEMA_NAME = "perdure.extrapolation"
SCHEMA_VERSION = "2"
COLUMNS: dict[str, type[pl.DataType]] = {
    "policy": pl.String,
    "method": pl.String,
    "task": pl.String,
    "train_seed": pl.Int64,
    "train_horizon": pl.Float64,
    "clock": pl.String,
    "clock_kind": pl.String,
    "clock_steps": pl.Float64,
    "eval_seed": pl.Int64,
    "test_horizon": pl.Int64,
    "step": pl.Int64,
    "return": pl.Float64,
    "alive": pl.Boolean,
    "end_reason": pl.String,
    "end_step": pl.Int64,
    "end_detail": pl.String,
    "movement_first": pl.Float64,
    "movement_last": pl.Float64,
    "idle_rate": pl.Float64,
    "reference_rate": pl.Float64,
    "level_rate": pl.Float64,
    "window": pl.Int64,
    "policy_state": pl.String,
    "policy_note": pl.String,
    "outcome": pl.String,
    "failed_step": pl.Int64,
    "end_hold": pl.Float64,
    "ever_idle": pl.Boolean,
}
_COLUMNS_1: dict[str, type[pl.DataType]] = {
    **dict(list(COLUMNS.items())[: list(COLUMNS).index("end_detail")]),
    "stuck_steps": pl.Int64,
    "first_tenth": pl.Float64,
    "last_tenth": pl.Float64,
}
_RESERVED = ("schema", "version", "sha256", "seal")
_SEAL = b"perdure-seal-"
_UNSEALED = _SEAL + 64 * b"0"


def write_table(path: str | os.PathLike[str], frame: pl.DataFrame, metadata: Mapping[str, str]) -> Path:
    """Write an extrapolation table as one Parquet file, whole.

    Args:
        path: Where to.
        frame: The columns of `COLUMNS`, in any order.
        metadata: Text by name for the file's key-value metadata, such as {"command": "perdure extrapolate ..."}.

    Returns:
        `path` as a `Path`.

    Raises:
        ReportError: The frame does not fit the schema, or the metadata uses a reserved name.
        OSError: The file cannot be written; an old one is untouched.
    """
    check_table(frame, "The table to write")
    for name, value in metadata.items():
        if name in _RESERVED or not isinstance(value, str):
            reserved = ", ".join(_RESERVED)
            raise ReportError(
                f"Metadata {name!r} = {value!r} cannot be: values are text, {reserved} are reserved names."
            )
    ordered = frame.select(list(COLUMNS))
    notes = {"schema": SCHEMA_NAME, "version": SCHEMA_VERSION, **metadata}
    buffer = io.BytesIO()
    ordered.write_parquet(
        buffer, metadata={**notes, "sha256": _digest(ordered.get_column, notes), "seal": _UNSEALED.decode()}
    )
    return write_atomic(path, _sealed(buffer.getvalue()))


def read_table(path: str | os.PathLike[str]) -> tuple[pl.DataFrame, dict[str, str]]:
    """Read an extrapolation table.

    Returns:
        (frame with the columns of `COLUMNS` in that order, metadata without the reserved names).

    Raises:
        ReportError: The file is missing, foreign, of another version, or damaged. One sentence says which.
    """
    file = _File(Path(path))
    frame = file.frame(list(file.columns))
    if file.columns is _COLUMNS_1:
        frame = _from_version_1(frame)
    check_table(frame, str(path))
    return frame, file.metadata


def read_lanes(path: str | os.PathLike[str]) -> tuple[tuple[Lanes, ...], dict[str, str]]:
    """Read an extrapolation table as its lanes, with little memory: see `Lanes`.

    Returns:
        (lanes of each task, metadata without the reserved names).

    Raises:
        ReportError: As `read_table`.
    """
    file = _File(Path(path))
    if file.columns is _COLUMNS_1:
        frame, metadata = read_table(path)
        return table_lanes(frame, str(path)), metadata
    return _lanes(file.column, str(path)), file.metadata


def check_table(frame: pl.DataFrame, name: str) -> None:
    """Check that a frame fits the schema: columns, types, values, and whole lanes.

    Raises:
        ReportError: With a sentence that begins with `name`.
    """
    table_lanes(frame, name)


def table_lanes(frame: pl.DataFrame, name: str) -> tuple[Lanes, ...]:
    """Return the lanes of a table, tasks in the order in which it names them.

    Raises:
        ReportError: The frame does not fit the schema; the sentence begins with `name`.
    """
    _check_columns(frame.schema, COLUMNS, name)
    return _lanes(frame.get_column, name)


def _lanes(column: Columns, name: str) -> tuple[Lanes, ...]:
    if column("step").is_empty():
        raise ReportError(f"{name} has no rows.")
    _check_values(column, name)
    return split_lanes(column, [each for each in COLUMNS if each not in CURVES], name)


def _check_columns(found: Mapping[str, object], columns: Mapping[str, type[pl.DataType]], name: str) -> None:
    missing = [column for column in columns if column not in found]
    unknown = [column for column in found if column not in columns]
    if missing or unknown:
        raise ReportError(f"{name} does not fit {SCHEMA_NAME}: missing columns {missing}, unknown columns {unknown}.")
    for column, kind in columns.items():
        if found[column] != kind:
            raise ReportError(f"{name}: column {column!r} is {found[column]}, not {kind.__name__}.")


def _from_version_1(frame: pl.DataFrame) -> pl.DataFrame:
    """Add what version 1 did not know."""
    unknown: dict[str, object] = {
        **dict.fromkeys(("movement_first", "movement_last", "idle_rate", "reference_rate", "level_rate"), math.nan),
        "end_detail": "",
        "window": 0,
        "policy_state": "cannot tell",
        "policy_note": "the table was written before idle robots were measured; evaluate again",
        "end_hold": math.nan,
        "ever_idle": False,
    }
    ended = {"terminated": "falls", "diverged": "diverges", "truncated": "cut", "survived": "unknown"}
    return frame.with_columns(
        outcome=pl.col("end_reason").replace_strict(ended, default="unknown"),
        failed_step=pl.col("end_step"),
        **{name: pl.lit(value, COLUMNS[name]) for name, value in unknown.items()},
    ).select(list(COLUMNS))


def _check_values(column: Columns, name: str) -> None:
    try:
        check_columns(column, ROW)
    except SchemaError as error:
        raise ReportError(f"{name} does not fit {SCHEMA_NAME}: {error}.") from None


class _File:
    """A Parquet file that holds a table, checked before a value of it is used."""

    def __init__(self, path: Path) -> None:
        if not path.is_file():
            raise ReportError(f"{path} does not exist." if not path.exists() else f"{path} is not a file.")
        content = path.read_bytes()
        if content[:4] != b"PAR1":
            raise ReportError(f"{path} is not a Parquet file.")
        sealed = _SEAL in content
        if sealed and _sealed(content) != content:
            raise ReportError(f"{path} is damaged: its bytes do not fit the SHA-256 they were sealed with.")
        try:
            self._parquet = Parquet(content)
            notes = self._parquet.notes
            NOTES.check(notes)
        except SchemaError as error:
            raise ReportError(f"{path} is a damaged Parquet file: {error}.") from None
        if notes.get("schema") != SCHEMA_NAME:
            raise ReportError(f"{path} is a Parquet file, but not a table of the schema {SCHEMA_NAME}.")
        version = notes.get("version")
        if version not in ("1", SCHEMA_VERSION):
            raise ReportError(
                f"{path} has version {version} of {SCHEMA_NAME}; this release reads versions 1 and {SCHEMA_VERSION}."
            )
        self.columns = _COLUMNS_1 if version == "1" else COLUMNS
        self.metadata = {name: text for name, text in notes.items() if name not in _RESERVED}
        _check_columns(self._parquet.columns, self.columns, str(path))
        notes.pop("seal", None)
        expected = notes.pop("sha256", None)
        # A seal that fits stands for the content.
        if not sealed and expected != _digest(self.column, notes, self.columns):
            raise ReportError(f"{path} is damaged: its content does not fit the SHA-256 it was written with.")

    def frame(self, names: list[str]) -> pl.DataFrame:
        """Return columns of the file."""
        return self._parquet.read(names)

    def column(self, name: str) -> pl.Series:
        """Return one column of the file."""
        return self.frame([name]).get_column(name)


def _sealed(content: bytes) -> bytes:
    """Write the SHA-256 of the file into its seal; the seal's own digits count as zeros."""
    at = content.rfind(_SEAL)
    before, after = content[:at], content[at + len(_UNSEALED) :]
    digest = hashlib.sha256(before + _UNSEALED + after).hexdigest()
    return before + _SEAL + digest.encode() + after


def _digest(column: Columns, notes: Mapping[str, str], columns: Mapping[str, type[pl.DataType]] = COLUMNS) -> str:
    """Return the SHA-256 of metadata and content. Parquet's own page checks miss most flipped bits (measured: 98 %)."""
    digest = hashlib.sha256(repr(sorted(notes.items())).encode())
    for name, kind in columns.items():
        series = column(name)
        if kind is pl.String:
            runs = series.rle().struct.unnest()  # labels repeat over thousands of rows
            digest.update(runs["len"].cast(pl.Int64).to_numpy().tobytes())
            digest.update("\0".join(map(str, runs["value"].to_list())).encode())
        else:
            digest.update(series.to_numpy().tobytes())
    return digest.hexdigest()
