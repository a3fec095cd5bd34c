"""Log files: Parquet, written whole; a damaged, foreign or contradictory file is refused by name."""

from __future__ import annotations

import hashlib
import io
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from perdure.home.errors import HomeError
from perdure.home.evaluate.log import EpisodeLog
from perdure.home.evaluate.outcomes.fields import HAND_OVERS, NOTES, POLICIES, ROW
from perdure.home.evaluate.outcomes.schema import (
    READABLE_VERSIONS,
    SCHEMA_NAME,
    SCHEMA_VERSION,
    columns,
    from_frame,
    to_frame,
)
from perdure.runs import write_result
from perdure.schema import Parquet, SchemaError, Table, read_json

if TYPE_CHECKING:
    import polars as pl

BODY = "columns_sha256"
_RESERVED = ("schema", "version", "sha256", BODY)


def write_logs(path: str | os.PathLike[str], logs: Sequence[EpisodeLog], notes: Mapping[str, str]) -> Path:
    """Write logs as one file, whole.

    Args:
        path: Where to.
        logs: Logs of an executor or of another simulator.
        notes: Goes into the file's metadata, such as `policies` and `command`.

    Raises:
        HomeError: If there are no logs, an episode is there twice, a value is out of range, or a note is no text or
            has a reserved name.
        StoreError: If the file cannot be written; an old one is untouched, the message says where the logs are kept.
    """
    check_distinct(logs, f"the logs for {os.fspath(path)}")
    reserved = [name for name, value in notes.items() if name in _RESERVED or not isinstance(value, str)]
    if reserved:
        raise HomeError(f"notes say {reserved}: values must be text, and {', '.join(_RESERVED)} are the file's own")
    frame = to_frame(logs)
    try:
        for row in frame.iter_rows(named=True):
            ROW.check(row)
    except SchemaError as error:
        raise HomeError(f"the logs for {os.fspath(path)} cannot be written: {error}") from None
    notes = {"schema": SCHEMA_NAME, "version": SCHEMA_VERSION, **notes}
    notes["sha256"] = _digest(frame, notes)
    # The columns' bytes do not depend on the metadata, which stands behind them: written once to know their digest.
    notes[BODY] = _body_digest(_parquet(frame, notes))
    return write_result(Path(path), _parquet(frame, notes))


def read_logs(path: str | os.PathLike[str]) -> list[EpisodeLog]:
    """Read a file of logs.

    Raises:
        HomeError: If it is missing, no Parquet file, of another schema or version, damaged, or contradicts itself.
    """
    frame, notes = _read_parquet(Path(path))
    if notes.get("schema") != SCHEMA_NAME:
        raise HomeError(f"{path} is a Parquet file, but not one of the schema {SCHEMA_NAME}")
    version = notes.get("version", "")
    if version not in READABLE_VERSIONS:
        known = " and ".join(READABLE_VERSIONS)
        raise HomeError(f"{path} has version {version or 'unknown'}; this package reads versions {known}")
    expected = columns(version)
    if dict(frame.schema) != expected:
        names = {**frame.schema, **expected}
        wrong = sorted(name for name in names if frame.schema.get(name) != expected.get(name))
        raise HomeError(f"{path} does not fit {SCHEMA_NAME}: wrong, missing or unknown columns {wrong}")
    notes.pop(BODY, None)
    if notes.pop("sha256", None) != _digest(frame, notes):
        raise HomeError(f"{path} is damaged: its content does not fit the SHA-256 it was written with")
    try:
        records = from_frame(frame)
        check_distinct(records, "it")
    except (HomeError, SchemaError) as error:
        raise HomeError(f"{path} does not hold what a file of logs must hold: {error}") from error
    return records


def read_notes(path: str | os.PathLike[str]) -> dict[str, str]:
    """Return the notes that the writer added to a log file, such as `command`.

    Raises:
        HomeError: If it is missing or no Parquet file; whether it is one of logs is looked at by `read_logs`.
    """
    return _read_parquet(Path(path))[1]


def noted_policies(notes: Mapping[str, str]) -> dict[str, str] | None:
    """Return the policy of each skill from the note `policies`, a JSON object; None where it is missing.

    Raises:
        HomeError: If it is something else.
    """
    return _note(notes, "policies", POLICIES) if "policies" in notes else None


def noted_hand_overs(notes: Mapping[str, str]) -> dict[str, int]:
    """Return the count of each hand-over outcome from the note `hand_overs`; empty where it is missing.

    Raises:
        HomeError: If it is something else than a JSON object of counts.
    """
    return _note(notes, "hand_overs", HAND_OVERS) if "hand_overs" in notes else {}


def _note(notes: Mapping[str, str], name: str, table: Table) -> dict[str, Any]:
    try:
        value = read_json(notes[name])
        table.check(value)
    except SchemaError as error:
        raise HomeError(f"the note {name} of logs must be a JSON object: {error}") from None
    return dict(value)


def check_distinct(records: Sequence[EpisodeLog], name: str) -> None:
    """HomeError when there is no record, or one episode of one strategy and its seeds is there twice."""
    if not records:
        raise HomeError(f"{name} must hold at least one episode")
    seen: set[Any] = set()
    for record in records:
        if record.key in seen:
            raise HomeError(f"{name} must not hold an episode twice: {record.name}")
        seen.add(record.key)


def _read_parquet(path: Path) -> tuple[pl.DataFrame, dict[str, str]]:
    if not path.is_file():
        raise HomeError(f"{path} is not a file" if path.exists() else f"{path} does not exist")
    content = path.read_bytes()
    if content[:4] != b"PAR1":
        raise HomeError(f"{path} is not a Parquet file")
    try:
        file = Parquet(content)
        notes = file.notes
        NOTES.check(notes)
        if BODY in notes and notes[BODY] != _body_digest(content):
            raise HomeError(f"{path} is damaged: its columns do not fit the SHA-256 they were written with")
        return file.read(), notes
    except SchemaError as error:
        raise HomeError(f"{path} is a damaged Parquet file: {error}") from None


def _parquet(frame: pl.DataFrame, notes: Mapping[str, str]) -> bytes:
    buffer = io.BytesIO()
    frame.write_parquet(buffer, metadata=dict(notes), compression_level=12)
    return buffer.getvalue()


def _body_digest(content: bytes) -> str:
    """SHA-256 of a Parquet file's column data: what stands before its footer.

    A file ends with its footer, the footer's length (4 bytes, little-endian) and "PAR1".
    """
    end = len(content) - 8 - int.from_bytes(content[-8:-4], "little")
    return hashlib.sha256(content[: max(end, 0)]).hexdigest()


def _digest(frame: pl.DataFrame, notes: Mapping[str, str]) -> str:
    """SHA-256 of metadata and content: Parquet's own checks let most flipped bits through."""
    digest = hashlib.sha256(repr(sorted(notes.items())).encode())
    for name in columns(notes.get("version", SCHEMA_VERSION)):
        digest.update(name.encode())
        _feed(digest, frame[name])
    return digest.hexdigest()


def _feed(digest: Any, series: pl.Series) -> None:
    """Feed a column, however deep it is nested: the lengths of its lists, then what is in them."""
    import polars as pl

    digest.update(f"{len(series)} {series.null_count()}".encode())
    if series.dtype == pl.List:
        lengths = series.list.len()
        digest.update(lengths.cast(pl.Int64).to_numpy().tobytes())
        _feed(digest, series.filter(lengths > 0).explode())
    elif series.dtype == pl.Struct:
        for part in series.struct.unnest():
            _feed(digest, part)
    elif series.dtype == pl.String:
        digest.update("\0".join(map(str, series.to_list())).encode())
    else:
        digest.update(series.to_numpy().tobytes())
