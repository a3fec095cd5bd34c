"""The table of days without a reset: one row an errand, as Parquet; everything is judged from it alone.

Hours are simulated, with the settling time after each errand. The columns are `COLUMNS`. The file's key-value metadata
holds `schema`, `version`, a SHA-256 of notes and rows, and the writer's notes.
"""

from __future__ import annotations

import hashlib
import math
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from perdure.errors import PerdureError
from perdure.home.evaluate.counts import TILTED, axis_tilt, four_counts
from perdure.home.evaluate.log import EpisodeLog
from perdure.home.evaluate.strategy import CALM, strategy_of
from perdure.home.sim.arrays import FloatArray
from perdure.home.sim.occupancy import free_space
from perdure.home.sim.pieces import LINK_CONTAINERS, Apartment
from perdure.home.sim.scene import EARLIER, SceneOptions
from perdure.home.tasks.errands import Errand, HomeState
from perdure.home.tasks.generation import NAVIGABLE_WITHIN
from perdure.home.tasks.planners import OpenLoop
from perdure.home.tasks.tasks import TASKS, Verb
from perdure.runs import write_atomic
from perdure.schema import Choice, Flag, Kind, Parquet, Real, Rule, Table, Text, Whole, check_columns, parquet_bytes

if TYPE_CHECKING:
    import polars as pl

SCHEMA_NAME = "perdure.home.day"
SCHEMA_VERSION = "2"
EARLIER_VERSION = "1"
"""Also read; it had no column `disturbance`, and is of the earlier physics."""
FLOOR = 0.2
"""An object whose middle is lower than this in [m] lies on the floor: the lowest surface is at 0.42 m (our choice)."""
STANDS = 0.1
"""A robot whose base stays within this in [m] of a point stands there (our choice)."""
GOES_ON = "goes on"
TIME_IS_UP = "the time is up"
NO_ERRAND_LEFT = "no errand left"
DIVERGED = "diverged"
ENDINGS = (GOES_ON, TIME_IS_UP, NO_ERRAND_LEFT, DIVERGED)
_NAME = Text(200, shortest=1)
_WORDS = Text(200)
_NUMBER = Whole(0, 10_000)
_HOURS = Real(0.0, 1e6)


@dataclass(frozen=True)
class DayColumn:
    """A column: what it may hold, and what it means."""

    kind: Kind
    about: str
    unit: str = ""
    key: bool = False
    """Whether no two rows may agree in all columns that have it."""


COLUMNS: Mapping[str, DayColumn] = {
    "errands": DayColumn(_NAME, "tasks of the day, in the order in which they alternate", key=True),
    "split": DayColumn(_NAME, "split of the home's first episode", key=True),
    "place": DayColumn(_NAME, "release strategy", key=True),
    "world": DayColumn(_WORDS, "options that differ from the usual world, in words", key=True),
    "planner": DayColumn(_NAME, "planner", key=True),
    "fallback": DayColumn(_NAME, "who takes over a skill that failed often", key=True),
    "disturbance": DayColumn(_NAME, "disturbances that acted together; none", key=True),
    "home": DayColumn(_NUMBER, "number of the home: a start that is never reset", key=True),
    "train_seed": DayColumn(Whole(-1), "training seed of the policies; -1: nothing was trained", key=True),
    "eval_seed": DayColumn(Whole(0), "evaluation seed: draws the robot's start pose and all goals", key=True),
    "errand": DayColumn(Whole(1, 1_000_000), "number of the errand in its home, from 1", key=True),
    "task": DayColumn(Choice(tuple(TASKS)), "its task"),
    "begin": DayColumn(_HOURS, "when it began", "h"),
    "end": DayColumn(_HOURS, "when it ended, settling time included", "h"),
    "stays": DayColumn(Flag(), "every stage was reached and every placement is goal-stabilizing"),
    "upright": DayColumn(Flag(), "every target stands at the end as a person would put it"),
    "undisturbed": DayColumn(Flag(), "no other object tipped, fell or moved by more than 5 cm"),
    "soft": DayColumn(Flag(), "contact forces stayed below their limits"),
    "targets": DayColumn(Whole(1, 100), "number of its targets"),
    "taken_over": DayColumn(_NUMBER, "skills that the oracle took over from a policy"),
    "fell": DayColumn(_NUMBER, "objects that lie on the floor after it and did not before"),
    "tipped_targets": DayColumn(_NUMBER, "targets that are tipped after it, those on the floor left out"),
    "knocked_over": DayColumn(_NUMBER, "other objects that are tipped after it and were not before"),
    "stood": DayColumn(
        Real(0.0, 1e6), "longest time in which the base stood within 0.1 m and no skill but reset_arm succeeded", "s"
    ),
    "on_floor": DayColumn(_NUMBER, "objects on the floor after it"),
    "tipped": DayColumn(_NUMBER, "objects that are tipped after it, those on the floor left out"),
    "out_of_reach": DayColumn(_NUMBER, "objects more than 1.5 m from where the robot can stand, after it"),
    "doors_open": DayColumn(_NUMBER, "drawers and doors of containers that are not closed after it"),
    "then": DayColumn(Choice(ENDINGS), "what came after it: " + ", ".join(f'"{word}"' for word in ENDINGS)),
}
"""All columns, in order."""
KEY = tuple(name for name, column in COLUMNS.items() if column.key)
HOME = tuple(name for name in KEY if name != "errand")
"""What identifies the day of a home."""
COUNTED = ("stays", "upright", "undisturbed", "soft")
GROUP = ("errands", "split", "place", "world", "planner", "fallback", "disturbance")
"""What the days of a group of homes have in common."""
HARM = ("on_floor", "tipped", "out_of_reach")
"""What makes a home worse."""
_RULES = (
    Rule("an errand ends before it begins", lambda of: of("end") < of("begin")),
    Rule("more targets are tipped than the errand has", lambda of: of("tipped_targets") > of("targets")),
)
Row = dict[str, Any]


def describe_columns() -> list[tuple[str, str, str]]:
    """Return name, unit and meaning of every column."""
    return [(name, column.unit, column.about) for name, column in COLUMNS.items()]


def errand_columns(log: EpisodeLog, errand: Errand, before: HomeState, after: HomeState) -> Row:
    """Return the columns of an errand that do not depend on its day: four counts, interventions, state of the home.

    Args:
        log: Its log, with its history.
        errand: What was asked for.
        before: The home before it.
        after: The home after it.
    """
    counted = four_counts(log, errand)
    floor_before = _on_floor(before)
    floor_after = _on_floor(after)
    tipped = _tipped(after) - floor_after
    targets = set(errand.numbers[: len(errand.goals)])
    limits = {link: container.closed for link, container in LINK_CONTAINERS.items()}
    return {
        "task": errand.task,
        **{name: bool(getattr(counted, name)) for name in COUNTED},
        "targets": len(targets),
        "fell": len(floor_after - floor_before),
        "tipped_targets": len(tipped & targets),
        "knocked_over": len(tipped - targets - _tipped(before)),
        "stood": longest_stand(log),
        "on_floor": len(floor_after),
        "tipped": len(tipped),
        "out_of_reach": _out_of_reach(errand.apartment(), after),
        "doors_open": sum(after.positions[link] > closed for link, closed in limits.items()),
    }


def _on_floor(state: HomeState) -> set[int]:
    return {number for number, placement in enumerate(state.objects) if placement.position[2] < FLOOR}


def _tipped(state: HomeState) -> set[int]:
    tilts = [axis_tilt(placement.kind, placement.quaternion) or 0.0 for placement in state.objects]
    return {number for number, tilt in enumerate(tilts) if tilt >= TILTED}


def _out_of_reach(apartment: Apartment, state: HomeState) -> int:
    places = np.array([placement.position[:2] for placement in state.objects])
    _, away = free_space(apartment, state.opened).nearest(places)
    return int((away >= NAVIGABLE_WITHIN).sum())


def longest_stand(log: EpisodeLog) -> float:
    """Return for how long in [s] the base stood at one place while the plan ran and no skill succeeded.

    The end of a successful skill begins the time again; `reset_arm`, which only folds the arm, does not count.
    """
    assert log.history is not None
    successes = {run.end for run in log.runs if run.success and run.skill != Verb.RESET_ARM}
    return _longest_stand(log.history.base[: log.steps, :2], successes) / log.control_hz


def _longest_stand(places: FloatArray, successes: set[int]) -> int:
    """Return the most steps between two in which the base left `STANDS` around where it was, or a skill succeeded."""
    points = places.tolist()
    begin = 0
    longest = 0
    for step, point in enumerate(points):
        if step in successes or math.dist(point, points[begin]) > STANDS:
            begin = step
        longest = max(longest, step - begin)
    return longest


def to_frame(rows: Sequence[Row]) -> pl.DataFrame:
    """Return rows as a table, ordered by `KEY`."""
    import polars as pl

    return pl.DataFrame(rows, schema=_types()).sort(KEY)


def _types() -> dict[str, pl.DataType]:
    import polars as pl

    known: Mapping[type, pl.DataType] = {
        Text: pl.String(),
        Choice: pl.String(),
        Whole: pl.Int64(),
        Real: pl.Float64(),
        Flag: pl.Boolean(),
    }
    return {name: known[type(column.kind)] for name, column in COLUMNS.items()}


def write_days(path: str | os.PathLike[str], frame: pl.DataFrame, notes: Mapping[str, str]) -> Path:
    """Write a table of days as one file, whole, and return its path.

    Args:
        path: Where to.
        frame: The columns of `COLUMNS`.
        notes: Goes into the file's metadata, such as `command`.

    Raises:
        PerdureError: If a value does not fit its column, an errand is there twice, or there is none.
    """
    check_days(frame, f"the table for {os.fspath(path)}")
    about = {"schema": SCHEMA_NAME, "version": SCHEMA_VERSION, **notes}
    return write_atomic(Path(path), parquet_bytes(frame, metadata={**about, "sha256": _digest(frame, about)}))


def read_days(path: str | os.PathLike[str]) -> tuple[pl.DataFrame, dict[str, str]]:
    """Return a table of days and the notes of its writer.

    Raises:
        PerdureError: If the file is missing, foreign, of another version, damaged, or a value does not fit.
    """
    path = Path(path)
    if not path.is_file():
        raise PerdureError(f"{path} is not a file" if path.exists() else f"{path} does not exist")
    try:
        file = Parquet(path.read_bytes())
        notes = dict(file.notes)
        found = (notes.get("schema"), notes.get("version"))
        if found not in ((SCHEMA_NAME, SCHEMA_VERSION), (SCHEMA_NAME, EARLIER_VERSION)):
            raise PerdureError(f"its schema is {found}, not {(SCHEMA_NAME, SCHEMA_VERSION)}")
        frame = file.read()
        if notes.pop("sha256", None) != _digest(frame, notes):
            raise PerdureError("it is damaged, its content does not fit its SHA-256")
        if found[1] == EARLIER_VERSION:
            frame = _from_earlier(frame)
        check_days(frame, "it")
    except PerdureError as error:
        raise PerdureError(f"{path} cannot be read as a table of days: {error}") from None
    return frame, {name: text for name, text in notes.items() if name not in ("schema", "version")}


def _from_earlier(frame: pl.DataFrame) -> pl.DataFrame:
    """Return a table of version 1 as one of today."""
    import polars as pl

    if "world" not in frame.columns:
        return frame  # which is refused
    earlier = strategy_of("", SceneOptions(**EARLIER), OpenLoop.name, "oracle").world
    world = pl.when(pl.col("world") == "").then(pl.lit(earlier)).otherwise(pl.col("world") + f", {earlier}")
    frame = frame.with_columns(world=world, disturbance=pl.lit(CALM))
    return frame.select([name for name in COLUMNS if name in frame.columns])


def check_days(frame: pl.DataFrame, name: str) -> None:
    """PerdureError, beginning with a name, unless a table fits `COLUMNS` and holds each errand once."""
    if dict(frame.schema) != _types():
        wrong = sorted({each for each, _ in set(frame.schema.items()) ^ set(_types().items())})
        raise PerdureError(f"{name} has wrong, missing or unknown columns: {', '.join(wrong or frame.columns)}")
    if frame.is_empty():
        raise PerdureError(f"{name} has no rows")
    try:
        check_columns(frame.get_column, Table({each: column.kind for each, column in COLUMNS.items()}, _RULES))
    except PerdureError as error:
        raise PerdureError(f"{name} does not fit: {error}") from None
    if frame.select(KEY).is_duplicated().any():
        raise PerdureError(f"{name} holds an errand twice")


def join_days(frames: Iterable[pl.DataFrame]) -> pl.DataFrame:
    """Return several tables of days as one, ordered by `KEY`."""
    import polars as pl

    return pl.concat(list(frames)).sort(KEY)


def _digest(frame: pl.DataFrame, notes: Mapping[str, str]) -> str:
    return hashlib.sha256(repr((sorted(notes.items()), frame.columns, frame.rows())).encode()).hexdigest()
