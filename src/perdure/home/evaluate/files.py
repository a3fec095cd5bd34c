"""Log files: a table of episodes as Parquet, which any simulator can write.

The columns are the fields of the classes in `log`, nested as they are: name, type, unit and what is allowed come from
there (`describe_columns` lists them). The file holds what happened; successes, causes and placements follow from it
when it is read. Its key-value metadata holds `schema`, `version`, a SHA-256 of notes and rows, and the writer's notes.
A damaged, foreign or contradictory file is refused by name.
"""

from __future__ import annotations

import hashlib
import io
import json
import math
import os
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, fields, is_dataclass, replace
from functools import cache
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_args, get_origin, get_type_hints

import numpy as np

from perdure.errors import PerdureError
from perdure.home.evaluate.log import Column, EpisodeLog, Event, Release
from perdure.home.evaluate.strategy import CALM, Strategy, strategy_of
from perdure.home.sim.arrays import FloatArray, IntArray
from perdure.home.sim.scene import SceneOptions, with_earlier_scene
from perdure.home.tasks.planners import FallbackName, OpenLoop
from perdure.runs import write_atomic
from perdure.schema import Count, Items, Kind, Parquet, Table, read_json

if TYPE_CHECKING:
    import polars as pl

SCHEMA_NAME = "perdure.home.episodes.log"
SCHEMA_VERSION = "6"
FORMAT = {"schema": SCHEMA_NAME, "version": SCHEMA_VERSION}
CALM_VERSION = "5"
"""Also read; it had no column `disturbance`, and releases without `_TOUCHES`."""
OLD_VERSION = "4"
"""Also read; it had `strategy` in place of `place` and the columns below, and a position of two containers an event."""
_NEW_COLUMNS = ("world", "planner", "fallback", "disturbance")
_TOUCHES = {"touches": -1, "pushed": math.nan}
"""Columns of a release that versions 4 and 5 lack, and what they mean there: unknown."""
_OLD_CONTAINERS = ("drawer", "fridge")
"""Fields of an event in version 4."""
_RESERVED = (*FORMAT, "sha256")
POLICIES = dict[str, str]
"""The note `policies`: skill to the name of its policy, which may hold a path."""
HAND_OVERS = dict[str, Count]
"""The note `hand_overs`: outcome of a release strategy to how often it came."""


@dataclass(frozen=True)
class NotedOptions:
    """What the note `protocol` says of options."""

    scene: SceneOptions = field(default_factory=SceneOptions)
    planner: str = OpenLoop.name
    fallback: FallbackName = "oracle"


@dataclass(frozen=True)
class NotedProtocol:
    """What the note `protocol` says of what was run."""

    place: str
    options: NotedOptions = field(default_factory=NotedOptions)


@dataclass(frozen=True)
class _Field:
    """A field of a class of `log`, as the table has it."""

    name: str
    column: Column
    part: Any
    """The class of its parts, if it is made of some."""
    many: bool
    """Whether a row holds a list of them."""
    scalar: type
    """bool, int, float or str."""
    array: bool

    @property
    def names(self) -> tuple[str, ...]:
        """Names of its columns."""
        return self.column.names or (self.name,)

    @property
    def kind(self) -> Kind:
        """What a cell may hold."""
        one = row_kind(self.part) if self.part else self.column.kind
        assert one is not None
        return Items(one, self.column.shortest, self.column.longest) if self.many else one

    @property
    def dtype(self) -> pl.DataType:
        """Type of its columns."""
        import polars as pl

        wide = {bool: pl.Boolean(), int: pl.Int64(), float: pl.Float64(), str: pl.String()}
        known = wide | {int: pl.Int32(), float: pl.Float32()} if self.column.narrow else wide
        one = pl.Struct(columns(self.part)) if self.part else known[self.scalar]
        return pl.List(one) if self.many else one

    def to_cells(self, value: Any) -> dict[str, Any]:
        """Return the cells of a value of this field."""
        if self.part is not None:
            value = [to_row(each) for each in value] if self.many else to_row(value)
        elif self.array:
            value = value.T.tolist()
        elif self.many:
            value = list(value)
        return dict(zip(self.names, value if self.column.names else [value], strict=True))

    def from_cells(self, row: Mapping[str, Any]) -> Any:
        """Return the value of this field from a row's cells."""
        cells = [row[name] for name in self.names]
        if self.array:
            if len({len(cell) for cell in cells}) != 1:
                raise PerdureError(f"the lists of {self.name} have different lengths: {[len(cell) for cell in cells]}")
            array = np.array(cells, dtype=np.int64 if self.scalar is int else np.float64).T
            return array if self.column.names else array[:, 0]
        value: Any = cells if self.column.names else cells[0]
        if self.part is not None:
            return tuple(from_row(self.part, each) for each in value) if self.many else from_row(self.part, value)
        return tuple(value) if self.many or self.column.names else value


@cache
def _fields(part: type) -> tuple[_Field, ...]:
    """Return the fields of a class of `log` that are columns."""
    found = []
    for name, hint in get_type_hints(part, include_extras=True).items():
        if get_origin(hint) is Annotated:
            inner, column = get_args(hint)
            array = {FloatArray: float, IntArray: int}.get(inner)
            one = get_args(inner)[0] if get_origin(inner) is tuple else inner
            many = array is not None or (get_origin(inner) is tuple and not column.names)
            scalar = array or (one if one in (bool, int, float) else str)
            nested: Any = one if is_dataclass(one) else None
            found.append(_Field(name, column, nested, many, scalar, array is not None))
    return tuple(found)


@cache
def row_kind(part: type) -> Table:
    """Return what a row of a class of `log` may hold."""
    return Table({name: each.kind for each in _fields(part) for name in each.names})


def columns(part: type = EpisodeLog) -> dict[str, pl.DataType]:
    """Return the columns of a class of `log` and their types."""
    return {name: each.dtype for each in _fields(part) for name in each.names}


def describe_columns(part: type = EpisodeLog, before: str = "") -> list[tuple[str, str, str]]:
    """Return name, unit and meaning of every column, those of nested tables below theirs (`runs.skill`)."""
    found = []
    for each in _fields(part):
        found.append((", ".join(before + name for name in each.names), each.column.unit, each.column.about))
        found += describe_columns(each.part, f"{before}{each.name}.") if each.part else []
    return found


def to_row(record: Any) -> dict[str, Any]:
    """Return a log, or a part of one, as a row."""
    part: Any = type(record)
    found = (each.to_cells(getattr(record, each.name)) for each in _fields(part))
    return {name: cell for cells in found for name, cell in cells.items()}


def from_row(part: type, row: Mapping[str, Any]) -> Any:
    """Return the log, or its part, of a row."""
    return part(**{each.name: each.from_cells(row) for each in _fields(part)})


def to_frame(records: Sequence[EpisodeLog]) -> pl.DataFrame:
    """Return logs as a table."""
    import polars as pl

    return pl.DataFrame([to_row(record) for record in records], schema=columns())


def _checked_rows(frame: pl.DataFrame) -> list[dict[str, Any]]:
    rows = frame.to_dicts()
    for row in rows:
        row_kind(EpisodeLog).check(row)
    return rows


def write_logs(path: str | os.PathLike[str], logs: Sequence[EpisodeLog], notes: Mapping[str, str]) -> Path:
    """Write logs as one file, whole.

    Args:
        path: Where to.
        logs: Logs of an executor or of another simulator.
        notes: Goes into the file's metadata, such as `policies` and `command`.

    Raises:
        PerdureError: If there are no logs, an episode is there twice, a value is out of range, a note is no text or has
            a reserved name, or the file cannot be written (an old one is untouched, the message says where the logs are
            kept).
    """
    check_distinct(logs, f"the logs for {os.fspath(path)}")
    if reserved := [name for name, value in notes.items() if name in _RESERVED or not isinstance(value, str)]:
        raise PerdureError(f"notes say {reserved}: values must be text, and {', '.join(_RESERVED)} are the file's own")
    frame = to_frame(logs)
    try:
        _checked_rows(frame)
    except PerdureError as error:
        raise PerdureError(f"the logs for {os.fspath(path)} cannot be written: {error}") from None
    buffer = io.BytesIO()
    about = {**FORMAT, **notes, "sha256": digest(frame, notes)}
    frame.write_parquet(buffer, metadata=about, compression_level=12)
    return write_atomic(Path(path), buffer.getvalue())


def read_logs(path: str | os.PathLike[str]) -> list[EpisodeLog]:
    """Return the logs of a file, see `read_log_file`."""
    return read_log_file(path)[0]


def read_log_file(path: str | os.PathLike[str]) -> tuple[list[EpisodeLog], dict[str, str]]:
    """Return the logs of a file, and the notes that its writer added, such as `command`.

    Raises:
        PerdureError: If it is missing, no Parquet file, of another schema or version, damaged, or contradicts itself.
    """
    path = Path(path)
    if not path.is_file():
        raise PerdureError(f"{path} is not a file" if path.exists() else f"{path} does not exist")
    content = path.read_bytes()
    if content[:4] != b"PAR1":
        raise PerdureError(f"{path} is not a Parquet file")
    try:
        file = Parquet(content)
    except PerdureError as error:
        raise PerdureError(f"{path} is a damaged Parquet file: {error}") from None
    notes = dict(file.notes)
    if notes.pop("schema", "") != SCHEMA_NAME:
        raise PerdureError(f"{path} is a Parquet file, but not one of the schema {SCHEMA_NAME}")
    version = notes.pop("version", "")
    if version not in (SCHEMA_VERSION, CALM_VERSION, OLD_VERSION):
        raise PerdureError(f"{path} has version {version or 'unknown'}; this package reads version {SCHEMA_VERSION}")
    try:
        frame = file.read()
        _check_columns(frame, _columns_of(version))
        if notes.pop("sha256", None) != digest(frame, notes, version):
            raise PerdureError("it is damaged, its content does not fit its SHA-256")
        frame = _of_today(frame, notes, version)
        records = [from_row(EpisodeLog, row) for row in _checked_rows(frame)]
        check_distinct(records, "it")
    except PerdureError as error:
        raise PerdureError(f"{path} does not hold what a file of logs must hold: {error}") from error
    return records, notes


def _check_columns(frame: pl.DataFrame, expected: Mapping[str, pl.DataType]) -> None:
    """Refuse a table with other columns or types."""
    if dict(frame.schema) != expected:
        names = {**frame.schema, **expected}
        wrong = sorted(name for name in names if frame.schema.get(name) != expected.get(name))
        raise PerdureError(f"wrong, missing or unknown columns {wrong}")


def _of_today(frame: pl.DataFrame, notes: Mapping[str, str], version: str) -> pl.DataFrame:
    """Return a table of any version as one of today."""
    if version == OLD_VERSION:
        return _from_old(frame, notes)
    if version == CALM_VERSION:
        return _from_calm(frame, notes)
    return frame


def _columns_of(version: str) -> dict[str, pl.DataType]:
    """Return the columns of a version."""
    if version == OLD_VERSION:
        return _old_columns()
    found = columns()
    if version == CALM_VERSION:
        found["releases"] = _untouched()
        del found["disturbance"]
    return found


def _untouched() -> pl.DataType:
    """Return the type of releases before touches were counted."""
    import polars as pl

    return pl.List(pl.Struct({name: dtype for name, dtype in columns(Release).items() if name not in _TOUCHES}))


def _from_calm(frame: pl.DataFrame, notes: Mapping[str, str]) -> pl.DataFrame:
    """Return a table of version 5 as one of today; its note `protocol` tells of which physics it is."""
    import polars as pl

    world = pl.col("world")
    with suppress(PerdureError):  # another simulator may note what it likes
        strategy = _noted_strategy(notes)
        if strategy is not None:
            world = pl.lit(strategy.world)
    calm = {"world": world, "disturbance": pl.lit(CALM), "releases": _releases_from_old()}
    return frame.with_columns(**calm).select(columns().keys())


def _releases_from_old() -> pl.Expr:
    """Return the releases of versions 4 and 5, whose touches are unknown."""
    import polars as pl

    release = pl.element().struct
    kept = [release.field(name) for name in columns(Release) if name not in _TOUCHES]
    unknown = [pl.lit(value).alias(name) for name, value in _TOUCHES.items()]
    return pl.col("releases").list.eval(pl.struct(*kept, *unknown))


def _old_columns() -> dict[str, pl.DataType]:
    """Return the columns of version 4, in which one text told what was run: "ik drag closed"."""
    import polars as pl

    event = columns(Event)
    del event["containers"]
    found = {}
    for name, dtype in columns().items():
        if name == "place":
            found["strategy"] = dtype
        elif name == "events":
            found["events"] = pl.List(pl.Struct({**event, **dict.fromkeys(_OLD_CONTAINERS, pl.Float64())}))
        elif name == "releases":
            found["releases"] = _untouched()
        elif name not in _NEW_COLUMNS:
            found[name] = dtype
    return found


def _from_old(frame: pl.DataFrame, notes: Mapping[str, str]) -> pl.DataFrame:
    """Return a table of version 4 as one of today; its note `protocol` tells what was run, else the text is kept."""
    import polars as pl

    strategy = _noted_strategy(notes)
    usual = {each.name: each.default for each in fields(EpisodeLog) if each.name in _NEW_COLUMNS}
    place = pl.col("strategy") if strategy is None else pl.lit(strategy.place)
    more = {name: pl.lit(value if strategy is None else getattr(strategy, name)) for name, value in usual.items()}
    parts = {"events": _events_from_old(), "releases": _releases_from_old()}
    return frame.with_columns(place=place, **parts, **more).select(columns().keys())


def _noted_strategy(notes: Mapping[str, str]) -> Strategy | None:
    """Return what the note `protocol` says was run; None where there is none."""
    if "protocol" not in notes:
        return None
    text = json.dumps(with_earlier_scene(read_json(notes["protocol"])))
    noted = read_json(text, NotedProtocol)
    return strategy_of(noted.place, noted.options.scene, noted.options.planner, noted.options.fallback)


def _events_from_old() -> pl.Expr:
    """Return the events of version 4 with a list of containers in place of a field for each."""
    import polars as pl

    event = pl.element().struct
    kept = [event.field(name) for name in columns(Event) if name != "containers"]
    each = [pl.struct(name=pl.lit(name), position=event.field(name)) for name in _OLD_CONTAINERS]
    return pl.col("events").list.eval(pl.struct(*kept, pl.concat_list(each).alias("containers")))


def read_note(notes: Mapping[str, str], name: str, kind: Any) -> dict[str, Any]:
    """Return a note that is a JSON object of some kind; empty where it is missing. PerdureError for anything else."""
    try:
        return dict(read_json(notes.get(name, "{}"), kind))
    except PerdureError as error:
        raise PerdureError(f"the note {name} of logs must be a JSON object: {error}") from None


def check_distinct(records: Sequence[EpisodeLog], name: str) -> None:
    """PerdureError when there is no record, or one episode of one strategy and its seeds is there twice."""
    if not records:
        raise PerdureError(f"{name} must hold at least one episode")
    seen: set[Any] = set()
    for record in records:
        if record.key in seen:
            raise PerdureError(f"{name} must not hold an episode twice: {record.name}")
        seen.add(record.key)


def read_log_files(
    paths: Sequence[str | os.PathLike[str]], names: Mapping[Path, str] | None = None
) -> list[tuple[list[EpisodeLog], dict[str, str], Any]]:
    """Return logs, notes and path of each file; PerdureError if an episode of a strategy is there twice.

    The name of a file or of a folder above it becomes the label of its strategies.
    """
    files = [(*read_log_file(path), path) for path in paths]
    for (logs, _, path), (given, name) in product(files, (names or {}).items()):
        if Path(path).is_relative_to(given):
            logs[:] = [replace(log, label=name) for log in logs]
    found: dict[Any, Any] = {}
    for record, path in ((record, path) for logs, _, path in files for record in logs):
        if record.key in found:
            raise PerdureError(f"{found[record.key]} and {path} both hold {record.name}; remove one, or give names")
        found[record.key] = path
    return files


def digest(frame: pl.DataFrame, notes: Mapping[str, str], version: str = SCHEMA_VERSION) -> str:
    """Return the SHA-256 of notes and rows: Parquet's own checks let most flipped bits through."""
    about = sorted({**FORMAT, "version": version, **notes}.items())
    return hashlib.sha256(repr((about, frame.columns, frame.rows())).encode()).hexdigest()
