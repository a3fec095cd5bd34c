"""The study of chapter 2 as a plan of steps and an analysis."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from perdure.studies.placement.grid import DEFAULT_PHASES, make_grid
from perdure.studies.placement.halt_in_noise import noise_step
from perdure.studies.placement.hand_over import hand_over_step
from perdure.studies.placement.page import QUESTION
from perdure.studies.placement.row_step import RunRow
from perdure.studies.study import Scale, Study, StudyStep


def plan(scale: str, out: Path, phases: Sequence[int]) -> list[StudyStep]:
    """Return all steps: one for each row of the grid, then the two measurements."""
    grid = make_grid(scale, phases)
    steps: list[StudyStep] = [RunRow(grid, row, out) for row in grid.rows]
    steps += [hand_over_step(grid, out)] if grid.hand_over_episodes else []
    steps += [noise_step(grid, out)] if grid.noise_episodes else []
    return steps


def analyze(scale: str, out: Path) -> list[Path]:
    """Write tables, figures and the page from what is there, of every phase."""
    from perdure.studies.placement.analyze import analyze as write

    return write(make_grid(scale, DEFAULT_PHASES), out)


STUDY = Study(
    "placement",
    QUESTION,
    (
        Scale("smoke", "SetTable and TidyHouse, policy alone and inverse kinematics, 2 episodes each; a few minutes"),
        Scale("laptop", "all rows with one training seed, 30 episodes each; a quarter of an hour on two cores"),
        Scale(
            "thesis",
            "three tasks, eight release strategies, six worlds, 3 training seeds; two hours on two cores",
            Path("results", "placement"),
        ),
    ),
    DEFAULT_PHASES,
    ("runs", "tables"),
    "Written by `perdure study placement`",
    plan,
    analyze,
)
