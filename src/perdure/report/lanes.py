"""Convert a table to lanes (deployed episodes): one row of facts for each lane, and curves as matrices.

A table repeats a lane's labels at every recorded step. A large table has millions of rows and thirty columns. Columns
are therefore read one by one, and most are kept only for each lane's last recorded step.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import polars as pl
from numpy.typing import NDArray

from perdure.report.errors import ReportError

LANE = ("task", "policy", "train_seed", "clock", "eval_seed")
"""Columns that identify a lane."""
OF_LANE = ("method", "train_horizon", "clock_kind", "clock_steps")
"""Columns that are the same in all rows of a lane."""
CURVES = ("step", "return", "alive")
"""Columns that differ from step to step."""

Columns = Callable[[str], pl.Series]
"""Name of a column to the column."""
IntArray = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Lanes:
    """All lanes of one task."""

    steps: IntArray
    """Recorded steps, shape (m,), rising."""
    facts: pl.DataFrame
    """One row for each lane: every column of the table but `CURVES`, and `place`, the row that names the lane first."""
    returns: NDArray[np.float64]
    """Shape (lanes, m)."""
    alive: NDArray[np.bool_]
    """Shape (lanes, m)."""


def split_lanes(column: Columns, facts: list[str], name: str) -> tuple[Lanes, ...]:
    """Return the lanes of each task, tasks in the order in which the table names them.

    Args:
        column: The table.
        facts: Columns to keep of each lane, `CURVES` left out.
        name: Of the table, for messages.

    Raises:
        ReportError: A lane has two rows for one step, or lanes of a task differ in recorded steps or test horizon.
    """
    keys, steps, order = _in_order(column, name)
    starts = _starts(keys)
    lengths = np.diff([*starts, len(steps)])
    _check_described(column, starts, order, name)
    whole = pl.DataFrame([column(each).gather(_original(starts + lengths - 1, order)) for each in facts])
    places = starts if order is None else np.minimum.reduceat(order, starts)
    whole = whole.with_columns(place=pl.Series(places))
    tasks = keys[0][starts]
    found = [np.flatnonzero(tasks == task) for task in dict.fromkeys(tasks[np.argsort(places)].tolist())]
    horizons = column("test_horizon").to_numpy()
    parts = []
    for lanes in found:
        index = starts[lanes, None] + np.arange(lengths[lanes[0]])
        rows = None if (lengths[lanes] != lengths[lanes[0]]).any() else _original(index, order)
        if rows is None or (steps[index] != steps[index[0]]).any() or np.ptp(horizons[rows]):
            task = whole["task"][int(lanes[0])]
            raise ReportError(f"{name}: the lanes on {task} do not share their recorded steps and test horizon.")
        parts.append((steps[index[0]], whole[lanes], rows))
    del keys, steps, horizons
    returns, alive = column("return").to_numpy(), column("alive").to_numpy()
    return tuple(Lanes(at, rows, returns[index], alive[index]) for at, rows, index in parts)


def _in_order(column: Columns, name: str) -> tuple[list[IntArray], IntArray, IntArray | None]:
    """Return codes of `LANE` and steps, lane after lane, and the rows in that order; None: the table has it."""
    keys, steps = [_codes(column(each)) for each in LANE], column("step").to_numpy()
    starts = _starts(keys)
    rising = np.diff(steps) > 0
    rising[starts[1:] - 1] = True
    if rising.all() and len(np.unique(np.column_stack([key[starts] for key in keys]), axis=0)) == len(starts):
        return keys, steps, None
    order = np.lexsort((steps, *reversed(keys)))
    keys, steps = [key[order] for key in keys], steps[order]
    again = np.diff(steps) == 0
    again[_starts(keys)[1:] - 1] = False
    if again.any():
        row = int(order[np.flatnonzero(again)[0]])
        lane = tuple(column(each)[row] for each in LANE)
        raise ReportError(f"{name} has the lane {lane} twice at step {column('step')[row]}.")
    return keys, steps, order


def _check_described(column: Columns, starts: IntArray, order: IntArray | None, name: str) -> None:
    """Refuse a lane whose rows describe it differently."""
    for each in OF_LANE:
        codes = _codes(column(each))
        codes = codes if order is None else codes[order]
        changed = codes[1:] != codes[:-1]
        if codes.dtype.kind == "f":
            changed &= ~(np.isnan(codes[1:]) & np.isnan(codes[:-1]))
        changed[starts[1:] - 1] = False
        if changed.any():
            row = int(_original(np.flatnonzero(changed), order)[0])
            raise ReportError(f"{name}: a lane on {column('task')[row]} has more than one {each}.")


def _codes(values: pl.Series) -> IntArray:
    """Return numbers that are equal where the values are."""
    if values.dtype == pl.String:
        values = values.cast(pl.Categorical).to_physical()
    return values.to_numpy()


def _starts(keys: list[IntArray]) -> IntArray:
    """Return the rows at which another lane begins."""
    changed = np.ones(len(keys[0]), np.bool_)
    changed[1:] = False
    for key in keys:
        changed[1:] |= key[1:] != key[:-1]
    return np.flatnonzero(changed)


def _original(rows: IntArray, order: IntArray | None) -> IntArray:
    return rows if order is None else order[rows]
