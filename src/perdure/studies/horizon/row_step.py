"""What the steps of a row share."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from perdure.runs import Store, Unit, read_status
from perdure.studies.horizon.grid import Grid, Row
from perdure.studies.study import StepProgress


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


def count_units(units: Sequence[Unit], folder: Path, total: int) -> StepProgress:
    """Return the progress of a step, one unit for each training seed.

    Args:
        units: Those that can run already.
        folder: Of their store, which need not exist.
        total: How many units there will be.
    """
    if not folder.is_dir() or not units:
        return StepProgress(total, 0)
    store, status = Store(folder), read_status(units, folder)
    open_units = [unit for unit in units if status[unit.key].state != "finished"]
    return StepProgress(
        total=total,
        done=len(units) - len(open_units),
        running=sum(store.is_busy(unit.key) for unit in open_units),
        failed=sum(store.note_path("failures", unit.key).exists() for unit in open_units),
        share=sum(each.share for each in status.values()) / total,
    )
