"""Run a row of the grid: one step of the study."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from perdure.home.errors import HomeError
from perdure.home.evaluate.protocol import LOGS, episode_blocks, run_protocol
from perdure.runs import Store, StoreError
from perdure.studies.errors import StudyError
from perdure.studies.placement.grid import Grid, Row, runs_folder
from perdure.studies.status import count_units
from perdure.studies.study import RunOptions, StepProgress

STAGES = {"val": "known layouts", "eval": "unseen layouts"}
"""Split to the stage's name."""
SPEED_TASK = "Ant-v3"
"""Task whose measured speed gives estimates of time. In home environments random actions end almost every episode at
once, so the time of resets would be measured."""
EPISODE_COST = {"set_table": 2_800, "tidy_house": 4_000, "prepare_groceries": 1_700}
"""Cost of an episode in steps of SPEED_TASK, measured on one core."""
START_SECONDS = 10.0
"""Seconds for reading policies and building scenes."""


@dataclass(frozen=True)
class RunRow:
    """All episodes of a row."""

    grid: Grid
    row: Row
    out: Path

    measure = "episodes"
    task = SPEED_TASK
    after: tuple[str, ...] = ()

    @property
    def key(self) -> str:
        """See `StudyStep`."""
        return self.row.key

    @property
    def stage(self) -> str:
        """See `StudyStep`."""
        return STAGES[self.row.split]

    @property
    def amount(self) -> float:
        """See `StudyStep`."""
        return float(self.row.total)

    def seconds(self, speed: float) -> float:
        """See `StudyStep`."""
        return START_SECONDS + self.amount * EPISODE_COST[self.row.task] / speed

    def progress(self) -> StepProgress:
        """See `StudyStep`; units are blocks of episodes."""
        return count_units(runs_folder(self.out), self._sizes())

    def _sizes(self) -> dict[str, int]:
        """Return the key and the number of episodes of each block."""
        protocol = self.row.protocol()
        return {block.key(protocol): block.last - block.first + 1 for block in episode_blocks(protocol)}

    def logs(self) -> list[Path]:
        """Return the logs of all blocks; none while one is missing."""
        folder, keys = runs_folder(self.out), self._sizes()
        if not folder.is_dir() or not all(Store(folder).done(key) for key in keys):
            return []
        return [Store(folder).get(key) / LOGS for key in keys]

    def run(self, options: RunOptions) -> None:
        """See `StudyStep`.

        Raises:
            RunError: A block of episodes failed.
            StudyError: A policy is missing, or the store holds these episodes with other settings.
        """
        settings: dict[str, Any] = {
            "cores": options.cores,
            "on": options.on,
            "command": self.row.command,
            "observe": options.observe,
            "waiting": options.waiting,
        }
        try:
            run_protocol(self.row.protocol(), runs_folder(self.out), **settings)
        except (HomeError, StoreError) as error:
            raise StudyError(str(error)) from error
