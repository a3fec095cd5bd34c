"""The grid of release strategies, tasks, worlds and splits. Immutable; add a line to extend it."""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from perdure.home.evaluate.protocol import EvaluationProtocol, read_strategy
from perdure.studies.errors import StudyError

TASKS = ("set_table", "tidy_house", "prepare_groceries")
DRAG, FRICTION = "drag", ""
"""Worlds as `strategy_name` writes them: drag only; rolling friction, the package's default."""
HULL, BASE, ZERO, JAWS = (
    "drag hull-apple",
    "drag base-velocity-removed",
    "drag released-at-zero-velocity",
    "jaws-apart drag",
)
FLAGS = {
    "drag": "--rolling drag",
    "hull-apple": "--apple hull",
    "base-velocity-removed": "--release-velocity base-removed",
    "released-at-zero-velocity": "--release-velocity zero",
    "jaws-apart": "--jaws apart",
}
"""Word of a world to the flag of `perdure home run`, in the order of `Row.command`."""
PHASES = {
    1: "three strategies on unseen layouts, drag only",
    2: "other worlds",
    3: "known layouts, as in the thesis",
    4: "jaws that touch again, policies trained for longer stays, a descent to contact",
    5: "descent and speed of the hand-over; halting under exploration noise",
}
DEFAULT_PHASES = tuple(PHASES)
THREE = ("rl", "stop", "ik")


@dataclass(frozen=True)
class Row:
    """Episodes of one task and split with one release strategy in one world."""

    task: str
    place: str
    """Release strategy, see `read_release`."""
    split: str
    """"val": layouts known from training; "eval": an unseen layout."""
    world: str
    phase: int
    train_seeds: int = 3
    eval_seeds: int = 1
    episodes: int = 100

    @property
    def strategy(self) -> str:
        """Strategy and world as logs name them, such as "ik drag"."""
        return f"{self.place} {self.world}".strip()

    @property
    def key(self) -> str:
        """Readable identity, such as "set_table/eval/ik drag"."""
        return f"{self.task}/{self.split}/{self.strategy}"

    @property
    def total(self) -> int:
        """Episodes of all seeds."""
        return self.episodes * self.train_seeds * self.eval_seeds

    @property
    def command(self) -> str:
        """The command that runs this row alone."""
        words = self.world.split()
        parts = [f"--place {self.place}", *(flag for word, flag in FLAGS.items() if word in words)]
        parts += ["--split eval"] if self.split == "eval" else []
        parts += [f"--episodes {self.episodes}"] if self.episodes != 100 else []
        parts += [f"--train-seeds {self.train_seeds}"] if self.train_seeds > 1 else []
        parts += [f"--eval-seeds {self.eval_seeds}"] if self.eval_seeds > 1 else []
        return shlex.join(["perdure", "home", "run", self.task, *" ".join(parts).split()])

    def protocol(self) -> EvaluationProtocol:
        """Return what is run."""
        _, options = read_strategy(self.strategy)
        counts = self.episodes, self.train_seeds, self.eval_seeds
        return EvaluationProtocol(self.task, self.place, self.split, *counts, options=options)


@dataclass(frozen=True)
class Grid:
    """A scale of the study."""

    name: str
    rows: tuple[Row, ...]
    hand_over_episodes: int = 0
    """Of each row of the hand-over measurement; 0: it is left out."""
    noise_episodes: int = 0
    """Likewise of halting under exploration noise."""


def _rows(
    tasks: Iterable[str], places: Iterable[str], split: str, world: str, phase: int, eval_seeds: int = 1
) -> tuple[Row, ...]:
    places = tuple(places)
    return tuple(Row(task, place, split, world, phase, 3, eval_seeds) for task in tasks for place in places)


def _smaller(rows: Iterable[Row], train_seeds: int, episodes: int) -> tuple[Row, ...]:
    return tuple(Row(row.task, row.place, row.split, row.world, row.phase, train_seeds, 1, episodes) for row in rows)


SET_TABLE = TASKS[:1]
THESIS_ROWS = (
    *_rows(TASKS, THREE, "eval", DRAG, 1, eval_seeds=3),
    *_rows(SET_TABLE, THREE, "eval", FRICTION, 2),
    *_rows(SET_TABLE, THREE, "eval", HULL, 2),
    *_rows(SET_TABLE, THREE, "eval", BASE, 2),
    *_rows(SET_TABLE, ("rl",), "eval", ZERO, 2),
    *_rows(TASKS[1:], THREE, "eval", FRICTION, 2),
    *_rows(TASKS, ("rl", "ik"), "val", DRAG, 3),
    *_rows(("tidy_house",), ("rl", "ik"), "eval", JAWS, 4),
    *_rows(TASKS, ("delta-200",), "eval", DRAG, 4),
    *_rows(SET_TABLE, ("delta-10", "delta-50", "delta-50-in-200"), "eval", DRAG, 4),
    *_rows(TASKS, ("ik+",), "eval", DRAG, 4),
)
SMOKE_ROWS = (
    *_rows(SET_TABLE, ("rl", "ik"), "val", DRAG, 1),
    *_rows(SET_TABLE, ("rl", "ik"), "eval", DRAG, 1),
    *_rows(("tidy_house",), ("rl", "ik"), "val", DRAG, 1),
)

GRIDS = {
    grid.name: grid
    for grid in (
        Grid("smoke", _smaller(SMOKE_ROWS, 1, 2)),
        Grid("laptop", _smaller(THESIS_ROWS, 1, 30), 30, 60),
        Grid("thesis", THESIS_ROWS, 100, 200),
    )
}


def make_grid(scale: str, phases: Sequence[int]) -> Grid:
    """Return the grid of a scale with the rows of some phases.

    Raises:
        StudyError: The scale has no work in these phases.
    """
    grid = GRIDS[scale]
    rows = tuple(row for row in grid.rows if row.phase in phases)
    measured = 5 in phases
    made = Grid(grid.name, rows, measured * grid.hand_over_episodes, measured * grid.noise_episodes)
    if not rows and not made.hand_over_episodes:
        known = ", ".join(map(str, sorted({row.phase for row in grid.rows} | ({5} if grid.noise_episodes else set()))))
        raise StudyError(f"scale {scale} has no work in phases {', '.join(map(str, phases))}; its phases are {known}")
    return made


def runs_folder(out: Path) -> Path:
    """Return the store of all episodes and measurements; too large to be committed."""
    return out / "runs"
