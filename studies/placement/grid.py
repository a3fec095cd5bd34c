"""The grid of release strategies, tasks, worlds and splits. Immutable; add a line to extend it."""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

from perdure.errors import PerdureError
from perdure.home.evaluate.execute import ExecutorOptions
from perdure.home.evaluate.protocol import EvaluationProtocol
from perdure.home.sim.scene import SceneOptions

TASKS = ("set_table", "tidy_house", "prepare_groceries")
MAIN_STRATEGIES = ("rl", "stop", "ik")
STRATEGIES = ("rl", "delta-10", "delta-50", "delta-50-in-200", "delta-200", "stop", "ik")
"""In the order of tables and figures."""
FRICTION = SceneOptions()
DRAG = SceneOptions(rolling=0.0)
HULL = replace(DRAG, apple="hull")
WORLDS = {
    "drag": "drag only",
    "drag hull-apple": "drag only, apple a convex hull",
    "": "rolling friction",
}
"""Words of a world in names to its name in tables, in their order."""
PHASES = {
    1: "three strategies on unseen layouts, drag only",
    2: "other worlds",
    3: "known layouts, as in the thesis",
    4: "policies trained for longer stays",
}


@dataclass(frozen=True)
class Row:
    """Episodes of one task and split with one release strategy in one world."""

    task: str
    place: str
    """Release strategy, see `read_release`."""
    split: str
    """"val": layouts known from training; "eval": an unseen layout."""
    world: SceneOptions
    phase: int
    train_seeds: int = 3
    eval_seeds: int = 1
    episodes: int = 100

    @property
    def strategy(self) -> str:
        """Strategy and world as logs name them, such as "ik drag"."""
        return self.protocol().name

    @property
    def total(self) -> int:
        """Episodes of all seeds."""
        return self.episodes * self.train_seeds * self.eval_seeds

    @property
    def command(self) -> str:
        """The command that runs this row alone."""
        usual = EvaluationProtocol(self.task)
        given = {name: getattr(self, name) for name in ("place", "split", "episodes", "train_seeds", "eval_seeds")}
        flags = {name: value for name, value in given.items() if value != getattr(usual, name) or name == "place"}
        words = [(f"--{name.replace('_', '-')}", str(value)) for name, value in {**flags, **self.world.unusual}.items()]
        return shlex.join(["perdure", "home", "run", self.task, *(word for pair in words for word in pair)])

    def protocol(self) -> EvaluationProtocol:
        """Return what is run."""
        counts = self.episodes, self.train_seeds, self.eval_seeds
        return EvaluationProtocol(self.task, self.place, self.split, *counts, options=ExecutorOptions(scene=self.world))


@dataclass(frozen=True)
class Grid:
    """A scale of the study."""

    rows: tuple[Row, ...]


def _rows(
    tasks: Iterable[str], places: Iterable[str], split: str, world: SceneOptions, phase: int, eval_seeds: int = 1
) -> tuple[Row, ...]:
    places = tuple(places)
    return tuple(Row(task, place, split, world, phase, 3, eval_seeds) for task in tasks for place in places)


def _smaller(rows: Iterable[Row], episodes: int) -> tuple[Row, ...]:
    return tuple(replace(row, train_seeds=1, eval_seeds=1, episodes=episodes) for row in rows)


SET_TABLE = TASKS[:1]
THESIS_ROWS = (
    *_rows(TASKS, MAIN_STRATEGIES, "eval", DRAG, 1, eval_seeds=3),
    *_rows(SET_TABLE, MAIN_STRATEGIES, "eval", FRICTION, 2),
    *_rows(SET_TABLE, MAIN_STRATEGIES, "eval", HULL, 2),
    *_rows(TASKS[1:], MAIN_STRATEGIES, "eval", FRICTION, 2),
    *_rows(TASKS, ("rl", "ik"), "val", DRAG, 3),
    *_rows(TASKS, ("delta-200",), "eval", DRAG, 4),
    *_rows(SET_TABLE, ("delta-10", "delta-50", "delta-50-in-200"), "eval", DRAG, 4),
)
SMOKE_ROWS = (
    *_rows(SET_TABLE, ("rl", "ik"), "val", DRAG, 1),
    *_rows(SET_TABLE, ("rl", "ik"), "eval", DRAG, 1),
    *_rows(("tidy_house",), ("rl", "ik"), "val", DRAG, 1),
)
GRIDS = {
    "smoke": Grid(_smaller(SMOKE_ROWS, 2)),
    "laptop": Grid(_smaller(THESIS_ROWS, 30)),
    "thesis": Grid(THESIS_ROWS),
}


def make_grid(scale: str, phases: Sequence[int]) -> Grid:
    """Return the grid of a scale with the rows of some phases.

    Raises:
        PerdureError: The scale has no work in these phases.
    """
    grid = GRIDS[scale]
    rows = tuple(row for row in grid.rows if row.phase in phases)
    if not rows:
        known = ", ".join(map(str, sorted({row.phase for row in grid.rows})))
        raise PerdureError(f"scale {scale} has no work in phases {', '.join(map(str, phases))}; its phases are {known}")
    return Grid(rows)
