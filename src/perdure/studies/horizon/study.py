"""The study of chapter 3 as a plan of steps and an analysis."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from perdure.studies.horizon.evaluation import evaluate_row
from perdure.studies.horizon.grid import DEFAULT_PHASES, GRIDS, make_grid
from perdure.studies.horizon.mechanism import mechanism_steps
from perdure.studies.horizon.rules import rule_steps
from perdure.studies.horizon.training import TrainRow
from perdure.studies.study import Scale, Study, StudyStep

QUESTION = "Does a policy trained in finite episodes hold for 100,000 steps, and does a constant time-to-go help?"


def plan(scale: str, out: Path, phases: Sequence[int]) -> list[StudyStep]:
    """Return all steps: every row's training, its evaluation on validation and test start states, short rollouts."""
    grid = make_grid(scale, phases)
    steps: list[StudyStep] = [TrainRow(grid, row, out) for row in grid.rows]
    evaluated = [row for row in grid.rows if row.evaluated]
    for split in grid.splits:
        steps += [evaluate_row(grid, row, split, out) for row in evaluated]
    return steps if grid.confirmatory else [*steps, *rule_steps(grid, out), *mechanism_steps(grid, out)]


def analyze(scale: str, out: Path) -> list[Path]:
    """Write tables, figures, the claim table and the page from the available results of all phases."""
    from perdure.studies.horizon.analyze import analyze as write

    return write(GRIDS[scale], out)


STUDY = Study(
    "horizon",
    QUESTION,
    (
        Scale("smoke", "every method on InvertedPendulum, 2 seeds x 4,096 steps, 2,000 test steps; a few minutes"),
        Scale(
            "laptop",
            "Hopper (CleanRL's settings; six methods, 5 seeds), HalfCheetah (three methods, 5 seeds) and Walker2d "
            "(three methods, 3 seeds), 1,000,000 training steps, 100,000 test steps; a night on four cores",
        ),
        Scale(
            "thesis", "five tasks, ten methods, up to 10 seeds, 100,000 test steps; days", Path("results", "horizon")
        ),
        Scale(
            "replication",
            "what `thesis` suggests, tested on fresh training runs: Hopper, Walker2d (CleanRL's settings) and "
            "HalfCheetah, three methods, 20 seeds, 100,000 test steps; a day on two cores",
            Path("results", "horizon-replication"),
        ),
    ),
    DEFAULT_PHASES,
    plan,
    analyze,
)
