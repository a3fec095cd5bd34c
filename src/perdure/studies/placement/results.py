"""Results: the committed table of strategies, and the rows of new logs."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

from perdure.runs import write_atomic
from perdure.studies.files import read_json_file
from perdure.studies.placement.names import RELEASE_STRATEGIES, TITLES, WORLDS
from perdure.studies.placement.schema import RESULTS

Row = dict[str, Any]
"""A row of the table: JSON values by name, see `schema.py`."""


@dataclass(frozen=True)
class Results:
    """Rows (a task, a split, a release strategy in a world) and paired differences of strategies."""

    commands: tuple[str, ...] = ()
    """That made the rows."""
    rows: tuple[Row, ...] = ()
    pairs: tuple[Row, ...] = ()

    @classmethod
    def read(cls, path: Path) -> Self:
        """Return the results of a file; none if it does not exist.

        Raises:
            StudyError: The file is damaged.
        """
        if not path.is_file():
            return cls()
        found = read_json_file(path, RESULTS)
        return cls(tuple(found["commands"]), tuple(found["rows"]), tuple(found["pairs"]))

    def merge(self, commands: Iterable[str], rows: Iterable[Row], pairs: Iterable[Row]) -> Results:
        """Return the results with new rows in the place of old ones, and without old pairs of a replaced row."""
        rows = list(rows)
        replaced = {_subject(row) for row in rows}
        still = [pair for pair in self.pairs if not _members(pair) & replaced]
        return Results(tuple(sorted({*self.commands, *commands})), _merged(self.rows, rows), _merged(still, pairs))

    def write(self, path: Path) -> Path:
        """Write them as a file that `read` reads."""
        values = {"commands": self.commands, "rows": self.rows, "pairs": self.pairs}
        return write_atomic(path, json.dumps(values, indent=1) + "\n")


def _merged(old: Iterable[Row], new: Iterable[Row]) -> tuple[Row, ...]:
    found = {_subject(row): row for row in (*old, *new)}
    return tuple(found[key] for key in sorted(found))


def _subject(row: Row) -> tuple[str, str, str]:
    return row["task"], row["split"], row["strategy"]


def _members(pair: Row) -> set[tuple[str, str, str]]:
    names = (" ".join(filter(None, (pair[side], pair["world"]))) for side in ("first", "second"))
    return {(pair["task"], pair["split"], name) for name in names}


def strategy_and_world(row: Row) -> tuple[str, str]:
    """Return the two parts of a row's name: `ik drag hull-apple` -> ("ik", "drag hull-apple")."""
    strategy, _, world = row["strategy"].partition(" ")
    return strategy, world


def chosen(rows: Iterable[Row], split: str, world: str | None = None, task: str | None = None) -> list[Row]:
    """Return rows of a split, perhaps of one world and task, by task, world and strategy."""
    worlds = WORLDS if world is None else (world,)

    def order(row: Row) -> tuple[int, int, int]:
        strategy, where = strategy_and_world(row)
        return list(TITLES).index(row["task"]), list(WORLDS).index(where), RELEASE_STRATEGIES.index(strategy)

    found = [row for row in rows if row["split"] == split and task in (None, row["task"])]
    return sorted((row for row in found if strategy_and_world(row)[1] in worlds), key=order)
