"""The table `perdure.extrapolation`, version 1: one row per lane and checkpoint step, as Parquet.

| column | type | meaning |
|---|---|---|
| policy | text | label of the policy, e.g. its file's stem |
| method | text | how it was trained, e.g. "geometric" |
| task | text | e.g. "Hopper-v3" |
| train_seed | int | seed of the training run |
| train_horizon | float | longest training horizon [steps]; inf: trained without an end; nan: unknown |
| clock | text | what the policy was told about time, e.g. "constant(500)"; "none" for a policy without embedding |
| clock_kind | text | "constant", "periodic", "countdown", "none" |
| clock_steps | float | the clock's number, e.g. C = 500; nan where there is none |
| eval_seed | int | start state: the same for every policy and clock of a task |
| test_horizon | int | steps the lane was asked to last |
| step | int | the checkpoint, > 0 |
| return | float | sum of rewards over the first `step` steps; an ended lane keeps its last value |
| alive | bool | the lane completed `step` steps without ending before |
| end_reason | text | "survived", "terminated", "truncated" or "diverged" |
| end_step | int | steps the lane lasted |
| stuck_steps | int | steps spent in a stuck phase up to this checkpoint |
| first_tenth | float | mean reward per step in the first tenth of `test_horizon`; nan while unknown |
| last_tenth | float | likewise for the last tenth; 0 for a lane that ended before |

A lane is (task, policy, train_seed, clock, eval_seed); all lanes of a task share their checkpoint steps. The file's
key-value metadata holds `schema`, `version`, a SHA-256 of the content and what the writer adds, such as the `command`.
"""

from __future__ import annotations

import hashlib
import io
import os
from collections.abc import Mapping
from pathlib import Path

import polars as pl

from perdure.report.errors import ReportError
from perdure.runs import write_whole

SCHEMA_NAME = "perdure.extrapolation"
SCHEMA_VERSION = "1"
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
    "stuck_steps": pl.Int64,
    "first_tenth": pl.Float64,
    "last_tenth": pl.Float64,
}
LANE = ("task", "policy", "train_seed", "clock", "eval_seed")
END_REASONS = ("survived", "terminated", "truncated", "diverged")
_RESERVED = ("schema", "version", "sha256")


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
    ordered.write_parquet(buffer, metadata={**notes, "sha256": _digest(ordered, notes)})
    return write_whole(path, buffer.getvalue())


def read_table(path: str | os.PathLike[str]) -> tuple[pl.DataFrame, dict[str, str]]:
    """Read an extrapolation table.

    Returns:
        (frame with the columns of `COLUMNS` in that order, metadata without the reserved names).

    Raises:
        ReportError: The file is missing, foreign, of another version, or damaged. One sentence says which.
    """
    frame, notes = _read_parquet(Path(path))
    if notes.get("schema") != SCHEMA_NAME:
        raise ReportError(f"{path} is a Parquet file, but not a table of the schema {SCHEMA_NAME}.")
    if notes.get("version") != SCHEMA_VERSION:
        raise ReportError(
            f"{path} has version {notes.get('version')} of {SCHEMA_NAME}; this release reads version {SCHEMA_VERSION}."
        )
    check_table(frame, str(path))
    if notes.pop("sha256", None) != _digest(frame, notes):
        raise ReportError(f"{path} is damaged: its content does not fit the SHA-256 it was written with.")
    return frame, {name: value for name, value in notes.items() if name not in _RESERVED}


def check_table(frame: pl.DataFrame, name: str) -> None:
    """Check that a frame fits the schema: columns, types, values, and whole lanes.

    Raises:
        ReportError: With a sentence that begins with `name`.
    """
    missing = [column for column in COLUMNS if column not in frame.columns]
    unknown = [column for column in frame.columns if column not in COLUMNS]
    if missing or unknown:
        raise ReportError(f"{name} does not fit {SCHEMA_NAME}: missing columns {missing}, unknown columns {unknown}.")
    for column, kind in COLUMNS.items():
        if frame.schema[column] != kind:
            raise ReportError(f"{name}: column {column!r} is {frame.schema[column]}, not {kind.__name__}.")
    if frame.is_empty():
        raise ReportError(f"{name} has no rows.")
    _check_values(frame, name)
    _check_lanes(frame, name)


def _check_values(frame: pl.DataFrame, name: str) -> None:
    empty = [column for column in COLUMNS if frame[column].null_count()]
    if empty:
        raise ReportError(f"{name} has missing values in {empty}.")
    reasons = sorted(set(frame["end_reason"].unique()) - set(END_REASONS))
    if reasons:
        raise ReportError(f"{name} has the end reasons {reasons}; known are {', '.join(END_REASONS)}.")
    beyond = frame.filter((pl.col("step") < 1) | (pl.col("step") > pl.col("test_horizon")))
    if not beyond.is_empty():
        step, last = beyond["step"][0], beyond["test_horizon"][0]
        raise ReportError(f"{name} has the checkpoint step {step}; steps are between 1 and the test horizon {last}.")


def _check_lanes(frame: pl.DataFrame, name: str) -> None:
    doubled = frame.select([*LANE, "step"]).is_duplicated()
    if doubled.any():
        first = frame.filter(doubled).select([*LANE, "step"]).row(0)
        raise ReportError(f"{name} has the lane {first[:-1]} twice at step {first[-1]}.")
    shape = frame.group_by("task", maintain_order=True).agg(
        steps=pl.col("step").n_unique(),
        lanes=pl.struct(LANE).n_unique(),
        rows=pl.len(),
        horizons=pl.col("test_horizon").n_unique(),
    )
    ragged = shape.filter((pl.col("steps") * pl.col("lanes") != pl.col("rows")) | (pl.col("horizons") > 1))
    if not ragged.is_empty():
        task = ragged["task"][0]
        raise ReportError(f"{name}: the lanes on {task} do not share their checkpoint steps and test horizon.")


def _read_parquet(path: Path) -> tuple[pl.DataFrame, dict[str, str]]:
    if not path.is_file():
        raise ReportError(f"{path} does not exist." if not path.exists() else f"{path} is not a file.")
    content = path.read_bytes()
    if content[:4] != b"PAR1":
        raise ReportError(f"{path} is not a Parquet file.")
    try:
        notes = pl.read_parquet_metadata(io.BytesIO(content))
        frame = pl.read_parquet(io.BytesIO(content))
    except (pl.exceptions.PolarsError, pl.exceptions.PanicException, OSError, ValueError, MemoryError) as error:
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        raise ReportError(f"{path} is a damaged Parquet file: {reason}") from error
    return frame, {name: value for name, value in notes.items() if name != "ARROW:schema"}


def _digest(frame: pl.DataFrame, notes: Mapping[str, str]) -> str:
    """SHA-256 of metadata and content. Parquet's own page checks let most flipped bits through (measured: 98 %)."""
    digest = hashlib.sha256(repr(sorted(notes.items())).encode())
    for column, kind in COLUMNS.items():
        series = frame[column]
        if kind is pl.String:
            runs = series.rle().struct.unnest()  # labels repeat over thousands of rows
            digest.update(runs["len"].cast(pl.Int64).to_numpy().tobytes())
            digest.update("\0".join(runs["value"].to_list()).encode())
        else:
            digest.update(series.to_numpy().tobytes())
    return digest.hexdigest()
