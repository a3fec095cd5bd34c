"""What the steps of a row share."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from perdure.studies.horizon.grid import Grid, Row


@dataclass(frozen=True)
class RowStep:
    """A `StudyStep` of one row, after the row's training."""

    grid: Grid
    row: Row
    out: Path
    stage: str

    measure = "lane steps"

    @property
    def key(self) -> str:
        """See `StudyStep`."""
        return f"{self.stage} {self.row.key}"

    @property
    def after(self) -> tuple[str, ...]:
        """See `StudyStep`."""
        return (f"training {self.row.key}",)

    @property
    def task(self) -> str:
        """See `StudyStep`."""
        return self.row.task
