"""The table `perdure.extrapolation`, version 5: one row per episode and recorded step, as Parquet.

An episode is one deployed run: a policy under a clock from a start state.

`TABLE` declares every column once: its type, what it may hold and what it means. All episodes of a task under one
disturbance share their recorded steps. The file's key-value metadata holds `schema`, `version`, the SHA-256 of the file
and what the writer adds, such as the `command`. Columns marked *judged* follow from the others and from the references
of the policies: `perdure report` computes them again.

"""

from __future__ import annotations

import hashlib
import math
import os
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import polars as pl
from msgspec import Meta
from numpy.typing import NDArray

from perdure.disturbances import CALM
from perdure.errors import PerdureError
from perdure.report.outcomes import OWN_TABLE_WORDS, POLICY_STATES, outcome_words
from perdure.report.scores import END_SURVIVED, IDLE_BELOW
from perdure.runs import write_atomic
from perdure.schema import (
    Choice,
    Count,
    Flag,
    Parquet,
    Real,
    Record,
    Rule,
    Table,
    Text,
    Whole,
    check_columns,
    checked,
    parquet_bytes,
    read_json,
)

SCHEMA_NAME = "perdure.extrapolation"
SCHEMA_VERSION = "5"
READABLE = ("4", "5")
"""Versions that are read. Version 4 has no columns that are `added`."""
RAW_VERSION = "4"
"""Of the columns that a simulator gives (`RAW`), part of the identity of stored groups of episodes. Raise it only if
one of them is added or gets another meaning. The other columns follow from them without simulation."""
MOST_STEPS = 10**15

# The declaration


@dataclass(frozen=True)
class Column:
    """One column."""

    kind: Text | Whole | Real | Flag | Choice
    """What it may hold; the type follows from it."""
    about: str
    """What it means, with its unit."""
    of: Literal["key", "episode", "step"] = "episode"
    """Whether it identifies the episode, describes it (equal in all its rows), or changes from step to step."""
    judged: bool = False
    """Whether it follows from the other columns and the policy's reference; else the evaluation gives it."""
    heading: str = ""
    """The page shows the mean over the episodes of a policy and clock under this heading; "": it does not."""
    added: bool = False
    """Whether tables of version 4 lack it; it is nan or empty there, and `perdure report` computes it."""

    @property
    def type(self) -> type[pl.DataType]:
        """The Polars type."""
        return _TYPES[type(self.kind)][0]

    @property
    def documentation(self) -> str:
        """What it means, with the words it may hold."""
        words = ", ".join(f'"{word}"' for word in self.kind.words) if isinstance(self.kind, Choice) else ""
        about = f"{self.about}: {words}" if words else self.about
        return f"{about} (judged)" if self.judged else about


_TYPES: dict[type, tuple[type[pl.DataType], str]] = {
    Text: (pl.String, "text"),
    Choice: (pl.String, "text"),
    Whole: (pl.Int64, "int"),
    Real: (pl.Float64, "float"),
    Flag: (pl.Boolean, "bool"),
}
NAME = Text(shortest=1)
"""Of a policy, a task, a method or a clock."""
_STEPS = Whole(1, MOST_STEPS)
_RATE = Real(unknown=True)
_SHARE = Real(0.0, 1.0, unknown=True)
_MOVEMENT = Real(0.0, unknown=True)
_HORIZON = Real(1.0, infinite=True, unknown=True)
_CLOCK_STEPS = Real(0.0, infinite=True, unknown=True)
END_REASONS = (END_SURVIVED, "terminated", "truncated", "diverged")

GOALS = {"goal_first_step": math.inf, "goal_longest_stay": 0.0, "goal_at_end": 0.0}
"""Columns about successes, with the value of an episode that has none."""
FILE_NOTE = "sha256 of "
"""How the names of the notes begin that say which policy files a table is of."""
IMPORTED = "imported"
"""Folder, beside the results, of policies made of other libraries' models."""
STOPPED_NOTE = "stopped_early"
"""Name of the note that holds an `EarlyStop` as JSON."""
TABLE: dict[str, Column] = {
    "policy": Column(NAME, "label of the policy, e.g. its file's stem", "key"),
    "method": Column(NAME, 'how it was trained, e.g. "geometric"'),
    "task": Column(NAME, 'e.g. "Hopper-v3"', "key"),
    "train_seed": Column(Whole(), "seed of the training run", "key"),
    "train_horizon": Column(_HORIZON, "longest training horizon [steps]; inf: trained without an end; nan: unknown"),
    "clock": Column(NAME, 'the policy\'s clock, e.g. "constant(500)"; "none" for a policy without embedding', "key"),
    "clock_kind": Column(NAME, 'of the clock, e.g. "constant"; "none" without one'),
    "clock_steps": Column(_CLOCK_STEPS, "the clock's number, e.g. C = 500; nan where there is none"),
    "eval_seed": Column(Whole(), "start state: the same for every policy and clock of a task", "key"),
    "disturbance": Column(
        NAME, 'what disturbed the episode, e.g. "standard-1" or "action_noise:0.1 push:0.5"; "none": nothing', "key"
    ),
    "not_applied": Column(Text(500), 'what of it the world could not do, e.g. "push, mass"; may be empty'),
    "step_seconds": Column(Real(0.0, unknown=True), "seconds of one control step; nan: unknown"),
    "test_horizon": Column(_STEPS, "steps of the episode, unless it ended earlier"),
    "step": Column(_STEPS, "a recorded step, > 0", "step"),
    "return": Column(Real(), "sum of rewards over the first `step` steps, or over all if it ended before", "step"),
    "alive": Column(Flag(), "the episode completed `step` steps without ending before", "step"),
    "end_reason": Column(Choice(END_REASONS), "why the episode ended"),
    "end_step": Column(_STEPS, "steps the episode lasted"),
    "end_detail": Column(
        Text(2000),
        "what led to the end: sign of divergence, first observation outside its training range; may be empty",
    ),
    "movement_first": Column(
        _MOVEMENT, "movement within 100 steps, in training standard deviations; mean of the first tenth"
    ),
    "movement_last": Column(_MOVEMENT, "likewise in the last tenth; nan for an episode that ended before"),
    "goal_first_step": Column(
        _HORIZON, "first step with a success; inf: no step had one; nan, here and below: the environment does not say"
    ),
    "goal_longest_stay": Column(Real(0.0, unknown=True), "most consecutive steps with a success"),
    "goal_at_end": Column(Real(0.0, 1.0, unknown=True), "1: the last step of the episode is a success; 0: it is none"),
    "idle_rate": Column(_RATE, "reward per step of an idle robot: the better of zero and random actions", judged=True),
    "training_rate": Column(_RATE, "reward per step of the policy within its training horizon", judged=True),
    "published_rate": Column(
        _RATE, "reward per step of a published policy of the task; nan: none is known", judged=True
    ),
    "window": Column(Whole(0, MOST_STEPS), "steps of the windows that are judged; 0: none", judged=True),
    "settling": Column(Whole(0, MOST_STEPS), "steps at the start that the score leaves out; 0: none", judged=True),
    "policy_state": Column(
        Choice(POLICY_STATES), "whether it gains enough over idle within its training horizon", judged=True
    ),
    "policy_note": Column(Text(2000), "the evidence for that", judged=True),
    "training_falls": Column(
        Real(0.0, 1.0, unknown=True),
        "share of the policy's reference episodes that the task ended within the training horizon; nan: unknown",
        judged=True,
    ),
    "outcome": Column(
        NAME, "the verdict on the episode: " + ", ".join(f'"{word}"' for word in OWN_TABLE_WORDS), judged=True
    ),
    "failed_step": Column(
        Whole(0, MOST_STEPS), "steps before the failure began; without a failure, all its steps", judged=True
    ),
    "end_score_vs_training": Column(
        Real(unknown=True),
        "score against its own training in the last tenth, or before the episode ended: (rate - idle_rate) / "
        "(training_rate - idle_rate), 0: an idle robot, 1: as in training; nan: not known",
        judged=True,
    ),
    "ever_idle": Column(
        Flag(),
        f"two consecutive windows after settling scored below {IDLE_BELOW:g}: hardly better than idle",
        judged=True,
        heading="ever idle",
    ),
    "way_rate": Column(
        _RATE,
        "reward per step of the policy on its way to where its reference settles; nan: it does so within a tenth of "
        "the horizon",
        judged=True,
        added=True,
    ),
    "training_low_share": Column(
        _SHARE, "share of the reference windows that score too low to hold", judged=True, added=True
    ),
    "low_share": Column(
        _SHARE, "share of the episode's windows after settling that do; nan: it has none", judged=True, added=True
    ),
    "idle_steps": Column(
        Real(0.0, unknown=True),
        "mean steps that the idle robot lasts, of at most 1,000; nan: unknown",
        judged=True,
        added=True,
    ),
    "other_engine": Column(
        Text(500), "in what it was trained and is judged, if MuJoCo differs; may be empty", judged=True, added=True
    ),
    "calm_rate": Column(
        _RATE,
        "reward per step of the policy under this clock when calm, after settling: of its calm episodes that hold; "
        "without one, training_rate",
        judged=True,
        added=True,
    ),
    "work_vs_calm": Column(
        _RATE,
        "work: (return - idle_rate x end_step) / ((calm_rate - idle_rate) x test_horizon), 0: an idle robot, 1: as "
        "when calm, to the end; nan: it never worked",
        judged=True,
        added=True,
        heading="work vs calm",
    ),
    "work_vs_published": Column(
        _RATE, "likewise with published_rate; nan: none is known", judged=True, added=True, heading="work vs published"
    ),
}
_MEASURE = Real(0.0, unknown=True)
MEASURES: dict[str, Column] = {
    "heading_error": Column(_MEASURE, "how far the robot turned from its commanded heading [degrees a minute]"),
    "lateral_drift": Column(_MEASURE, "how far to the side of its commanded path it was [m a minute]"),
    "velocity_error": Column(_MEASURE, "mean distance from the commanded planar velocity [m/s]"),
    "energy_per_meter": Column(_MEASURE, "positive mechanical work of the motors [J/m]"),
}
"""Columns of tables whose environment reports them in its infos; nan where it does not."""
COLUMNS: dict[str, type[pl.DataType]] = {name: column.type for name, column in TABLE.items()}
"""Name and type of every column, in order."""
EPISODE = tuple(name for name, column in TABLE.items() if column.of == "key")
OF_EPISODE = tuple(name for name, column in TABLE.items() if column.of == "episode")
CURVES = tuple(name for name, column in TABLE.items() if column.of == "step")
JUDGED = tuple(name for name, column in TABLE.items() if column.judged)
RAW = tuple(name for name in TABLE if name not in JUDGED)
ADDED = tuple(name for name, column in TABLE.items() if column.added)


def row_kind() -> Table:
    """Return what one row may hold; its outcome may be one that another package registers."""
    kinds = {name: column.kind for name, column in TABLE.items()}
    return Table({**kinds, "outcome": Choice(outcome_words(in_table=True))}, RULES)


RULES = (
    Rule(
        f"train_horizon must be at most {MOST_STEPS:.0e} steps, or infinite",
        lambda of: of("train_horizon").is_finite() & (of("train_horizon") > MOST_STEPS),
    ),
    Rule("the recorded step lies beyond the test horizon", lambda of: of("step") > of("test_horizon")),
    Rule("end_step lies beyond the test horizon", lambda of: of("end_step") > of("test_horizon")),
    Rule("failed_step lies beyond the test horizon", lambda of: of("failed_step") > of("test_horizon")),
    Rule("the episode is alive after its end_step", lambda of: of("alive") & (of("step") > of("end_step"))),
    Rule("the episode has ended before its end_step", lambda of: ~of("alive") & (of("step") < of("end_step"))),
)
"""What the columns of a row have in common."""
NOTES = dict[str, Annotated[str, Meta(max_length=100_000)] | None]
"""The file's metadata: any text, for `printable` to clean where it is shown."""
__doc__ = "\n".join(
    [
        f"{__doc__ or ''}| column | type | meaning |",
        "|---|---|---|",
        *(f"| {name} | {_TYPES[type(each.kind)][1]} | {each.documentation} |" for name, each in TABLE.items()),
        *(f"| {name} | float | only of robots' walks: {each.documentation} |" for name, each in MEASURES.items()),
    ]
)


class EarlyStop(Record, frozen=True):
    """An evaluation that ended before all of its episodes, because the others could not change the verdict."""

    episodes: Count
    """Episodes that ran."""
    planned: Count
    """Episodes of the whole evaluation."""
    reason: str
    """What decided the verdict."""

    def __str__(self) -> str:
        return f"stopped early, after {self.episodes:,} of {self.planned:,} episodes: {self.reason}"


def early_stop(notes: Mapping[str, str]) -> EarlyStop | None:
    """Return what the notes of a table say about an early stop; None: all episodes ran.

    Raises:
        PerdureError: The note is damaged.
    """
    if STOPPED_NOTE not in notes:
        return None
    try:
        found: EarlyStop = read_json(notes[STOPPED_NOTE], EarlyStop)
    except PerdureError as error:
        raise PerdureError(f"the note {STOPPED_NOTE!r} of the table is damaged: {error}") from None
    return found


# Writing and reading

_RESERVED = ("schema", "version", "sha256", "seal")
_SEAL = b"perdure-seal-"
_UNSEALED = _SEAL + 64 * b"0"


def write_table(path: str | os.PathLike[str], frame: pl.DataFrame, metadata: Mapping[str, str]) -> Path:
    """Write an extrapolation table as one Parquet file, whole, and return its path.

    Args:
        path: Where to.
        frame: The columns of `COLUMNS`, and perhaps of `MEASURES`, in any order.
        metadata: Text by name for the file's key-value metadata, such as {"command": "perdure extrapolate ..."}.

    Raises:
        PerdureError: The frame does not fit the schema, or the metadata uses a reserved name.
        OSError: The file cannot be written; an old one is untouched.
    """
    table_episodes(frame, "The table to write")
    for name, value in metadata.items():
        if name in _RESERVED or not isinstance(value, str):
            raise PerdureError(f"Metadata {name!r} = {value!r} cannot be: values are text, {_RESERVED} are reserved.")
    notes = {"schema": SCHEMA_NAME, "version": SCHEMA_VERSION, **metadata, "seal": _UNSEALED.decode()}
    return write_atomic(path, sealed(parquet_bytes(frame.select(_known(frame.columns)), metadata=notes)))


def read_table(path: str | os.PathLike[str]) -> tuple[pl.DataFrame, dict[str, str]]:
    """Read an extrapolation table.

    Returns:
        (frame with the columns of `COLUMNS` and those of `MEASURES` that it has in that order, metadata without the
        reserved names).

    Raises:
        PerdureError: The file is missing, foreign, of another version, or damaged. One sentence says which.
    """
    parquet, notes = _open(Path(path))
    frame = parquet.read([name for name in _known(parquet.columns) if name in parquet.columns])
    frame = frame.with_columns(pl.lit(_unknown(name)).alias(name) for name in ADDED if name not in frame.columns)
    frame = frame.select(_known(frame.columns))
    table_episodes(frame, str(path))
    return frame, notes


def read_episodes(path: str | os.PathLike[str]) -> tuple[tuple[Episodes, ...], dict[str, str]]:
    """Read an extrapolation table as its episodes, column by column with little memory.

    Returns:
        (episodes of each task and disturbance, metadata without the reserved names).

    Raises:
        PerdureError: As `read_table`.
    """
    parquet, notes = _open(Path(path))

    def column(name: str) -> pl.Series:
        if name not in parquet.columns:
            return pl.repeat(_unknown(name), parquet.read(["step"]).height, eager=True).alias(name)
        return parquet.read([name]).get_column(name)

    return _episodes(column, parquet.columns, str(path)), notes


def _unknown(column: str) -> float | str:
    """Return what a column that is `added` holds in a table that lacks it."""
    return "" if isinstance(TABLE[column].kind, Text) else math.nan


def _open(path: Path) -> tuple[Parquet, dict[str, str]]:
    """Return a file that holds a table, checked before a value of it is used, and its metadata."""
    if not path.is_file():
        raise PerdureError(f"{path} does not exist." if not path.exists() else f"{path} is not a file.")
    content = path.read_bytes()
    if content[:4] != b"PAR1":
        raise PerdureError(f"{path} is not a Parquet file.")
    # Parquet's own page checks miss most flipped bits (measured: 98 %).
    if _SEAL in content and sealed(content) != content:
        raise PerdureError(f"{path} is damaged: its bytes do not fit the SHA-256 they were written with.")
    try:
        parquet = Parquet(content)
        notes = parquet.notes
        checked(notes, NOTES)
    except PerdureError as error:
        raise PerdureError(f"{path} is a damaged Parquet file: {error}.") from None
    if notes.get("schema") != SCHEMA_NAME:
        raise PerdureError(f"{path} is a Parquet file, but not a table of the schema {SCHEMA_NAME}.")
    if notes.get("version") not in READABLE:
        found = notes.get("version")
        known = " and ".join(READABLE)
        raise PerdureError(f"{path} has version {found} of {SCHEMA_NAME}; this release reads versions {known}.")
    if _SEAL not in content:
        raise PerdureError(f"{path} is damaged: it has no SHA-256.")
    _check_columns(parquet.columns, str(path), ADDED if notes["version"] != SCHEMA_VERSION else ())
    return parquet, {name: text for name, text in notes.items() if name not in _RESERVED}


def sealed(content: bytes) -> bytes:
    """Return the file with its SHA-256 in its metadata; the digest's own digits count as zeros."""
    at = content.rfind(_SEAL)
    before = content[:at]
    after = content[at + len(_UNSEALED) :]
    return before + _SEAL + hashlib.sha256(before + _UNSEALED + after).hexdigest().encode() + after


def _known(found: Collection[str]) -> list[str]:
    return [*COLUMNS, *(name for name in MEASURES if name in found)]


def _check_columns(found: Mapping[str, object], name: str, may_lack: Collection[str] = ()) -> None:
    """Refuse columns that do not fit the schema.

    Args:
        found: Name and type of each.
        name: Of the table, for the message.
        may_lack: Columns that need not be there.
    """
    known = [each for each in _known(found) if each in found or each not in may_lack]
    missing = [each for each in COLUMNS if each not in found and each not in may_lack]
    unknown = [each for each in found if each not in known]
    if missing or unknown:
        raise PerdureError(f"{name} does not fit {SCHEMA_NAME}: missing columns {missing}, unknown columns {unknown}.")
    for column in known:
        kind = COLUMNS.get(column, pl.Float64)
        if found[column] != kind:
            raise PerdureError(f"{name}: column {column!r} is {found[column]}, not {kind.__name__}.")


# Episodes: a table repeats an episode's labels at every recorded step, and a large one has millions of rows and thirty
# columns. Columns are therefore read one by one, and most are kept only for each episode's last recorded step.

Columns = Callable[[str], pl.Series]
"""Name of a column to the column."""
IntArray = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Episodes:
    """All episodes of one task under one disturbance."""

    steps: IntArray
    """Recorded steps, shape (m,), rising."""
    facts: pl.DataFrame
    """One row for each episode: every column of the table but `CURVES`, and `place`, the row that names it first."""
    returns: NDArray[np.float64]
    """Shape (episodes, m)."""
    alive: NDArray[np.bool_]
    """Shape (episodes, m)."""


def table_episodes(frame: pl.DataFrame, name: str) -> tuple[Episodes, ...]:
    """Return the episodes of a table by task and disturbance, in the order in which it names them.

    Raises:
        PerdureError: The frame does not fit the schema, an episode has two rows for one step or two values of a column
            that describes it, or episodes of a task and disturbance differ in recorded steps or test horizon. The
            sentence begins with `name`.
    """
    _check_columns(frame.schema, name)
    return _episodes(frame.get_column, frame.columns, name)


def _episodes(column: Columns, names: Collection[str], name: str) -> tuple[Episodes, ...]:
    measures = [each for each in MEASURES if each in names]
    if column("step").is_empty():
        raise PerdureError(f"{name} has no rows.")
    try:
        check_columns(column, row_kind())
        check_columns(column, Table(dict.fromkeys(measures, _MEASURE)))
    except PerdureError as error:
        raise PerdureError(f"{name} does not fit {SCHEMA_NAME}: {error}.") from None
    codes = [_codes(column(each)) for each in (*EPISODE, "step")]
    order = np.lexsort(codes[::-1])
    *keys, steps = (each[order] for each in codes)
    del codes
    # Whether a row belongs to the episode of the row before it.
    inside = np.all([key[1:] == key[:-1] for key in keys], axis=0)
    del keys
    again = np.flatnonzero(inside & (steps[1:] == steps[:-1]))
    if again.size:
        row = int(order[again[0] + 1])
        episode = tuple(column(each)[row] for each in EPISODE)
        raise PerdureError(f"{name} has the episode {episode} twice at step {column('step')[row]}.")
    for each in (*OF_EPISODE, *measures):
        values = _codes(column(each))[order]
        changed = np.flatnonzero(inside & (values[1:] != values[:-1]))
        if changed.size:
            task = column("task")[int(order[changed[0]])]
            raise PerdureError(f"{name}: an episode on {task} has more than one {each}.")
    starts = np.flatnonzero(np.concatenate([[True], ~inside]))
    lengths = np.diff([*starts, len(order)])
    last = order[starts + lengths - 1]
    facts = pl.DataFrame([column(each).gather(last) for each in COLUMNS if each not in CURVES])
    measured = {each: column(each).gather(last) if each in names else pl.lit(math.nan) for each in MEASURES}
    facts = facts.with_columns(place=pl.Series(np.minimum.reduceat(order, starts)), **measured)
    parts = []
    for task, disturbance in facts.sort("place").select("task", "disturbance").unique(maintain_order=True).iter_rows():
        mine = np.flatnonzero((facts["task"] == task) & (facts["disturbance"] == disturbance))
        index = starts[mine, None] + np.arange(lengths[mine[0]])
        if (
            (lengths[mine] != lengths[mine[0]]).any()
            or (steps[index] != steps[index[0]]).any()
            or facts["test_horizon"][mine].n_unique() > 1
        ):
            under = "" if disturbance == CALM else f" under {disturbance}"
            raise PerdureError(
                f"{name}: the episodes on {task}{under} do not share their recorded steps and test horizon."
            )
        parts.append((steps[index[0]], facts[mine], order[index]))
    returns = column("return").to_numpy()
    alive = column("alive").to_numpy()
    return tuple(Episodes(at, described, returns[rows], alive[rows]) for at, described, rows in parts)


def _codes(values: pl.Series) -> IntArray:
    """Return whole numbers that are equal where the values are."""
    if values.dtype == pl.String:
        values = values.cast(pl.Categorical).to_physical()
    array = values.to_numpy()
    return array.view(np.int64) if array.dtype == np.float64 else array
