"""The grid of release strategies, tasks, worlds and splits. Immutable; add a line to extend it."""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import product

from perdure.errors import PerdureError
from perdure.home.evaluate.execute import ExecutorOptions
from perdure.home.evaluate.protocol import EvaluationProtocol
from perdure.home.evaluate.strategy import Strategy, strategy_of
from perdure.home.sim.objects import ROLLING
from perdure.home.sim.scene import LEVERS, SceneOptions
from perdure.home.tasks.planners import FallbackName

TASKS = ("set_table", "tidy_house", "prepare_groceries")
RELEASES = ("rl", "stop", "ik", "guarded")
TRAINED = ("gentle",)
"""Place policies that were trained otherwise; on SetTable only."""
STRATEGIES = ("rl", *TRAINED, *RELEASES[1:])
"""In the order of tables and figures."""
PHASES = {
    1: "three tasks, open and closed loop, an unseen layout",
    2: "five more unseen layouts",
    3: "rolling resistance",
    4: "known layouts and an open loop with drag only, as in the thesis",
    5: "success as a person means it: closed loop, with and without the oracle as fallback",
}


@dataclass(frozen=True)
class Row:
    """Episodes of one task and split with one release strategy in one world."""

    task: str
    place: str
    """Release strategy, see `read_release`."""
    split: str
    """"val": layouts known from training; "eval": an unseen layout; "eval-2": five more."""
    planner: str
    rolling: float
    """Lever arm in [m], from 0 (only drag, as in Habitat) to the default."""
    phase: int
    train_seeds: int = 3
    eval_seeds: int = 1
    episodes: int = 100
    fallback: FallbackName = "oracle"

    @property
    def strategy(self) -> Strategy:
        """What is run, as logs have it."""
        return self.protocol().strategy

    @property
    def command(self) -> str:
        """The command that runs this row alone."""
        usual = EvaluationProtocol(self.task)
        given = {name: getattr(self, name) for name in ("place", "split", "episodes", "train_seeds", "eval_seeds")}
        flags = {name: value for name, value in given.items() if value != getattr(usual, name) or name == "place"}
        flags |= SceneOptions(rolling=self.rolling).unusual
        for name in ("planner", "fallback"):
            if getattr(self, name) != getattr(usual.options, name):
                flags[name] = getattr(self, name)
        words = [(f"--{name.replace('_', '-')}", str(value)) for name, value in flags.items()]
        return shlex.join(["perdure", "home", "run", self.task, *(word for pair in words for word in pair)])

    def protocol(self) -> EvaluationProtocol:
        """Return what is run."""
        counts = self.episodes, self.train_seeds, self.eval_seeds
        scene = SceneOptions(rolling=self.rolling)
        options = ExecutorOptions(scene=scene, planner=self.planner, fallback=self.fallback)
        return EvaluationProtocol(self.task, self.place, self.split, *counts, options=options)


def _rows(
    phase: int,
    tasks: Iterable[str],
    places: Iterable[str],
    levers: Iterable[float] = (ROLLING,),
    planner: str = "closed",
    split: str = "eval",
    eval_seeds: int = 1,
    episodes: int = 100,
) -> tuple[Row, ...]:
    return tuple(
        Row(task, place, split, planner, lever, phase, eval_seeds=eval_seeds, episodes=episodes)
        for task, place, lever in product(tasks, places, levers)
    )


def _smaller(rows: Iterable[Row], episodes: int, train_seeds: int) -> tuple[Row, ...]:
    return tuple(replace(row, train_seeds=train_seeds, eval_seeds=1, episodes=episodes) for row in rows)


def _without_fallback(rows: Iterable[Row]) -> tuple[Row, ...]:
    return tuple(replace(row, fallback="none") for row in rows)


SET_TABLE = TASKS[:1]
SMALL = LEVERS[:-1]
DRAG = strategy_of("", SceneOptions(rolling=0.0), "closed", "oracle").world
"""The world in which only drag slows a rolling object, as logs have it."""
JUDGED = ("rl", "stop")
"""Strategies that are judged as a person means it; the closed loop of the others is in phase 1."""
THESIS_ROWS = (
    *_rows(1, TASKS, RELEASES, planner="open", eval_seeds=3),
    *_rows(1, TASKS, RELEASES[2:], eval_seeds=3),
    *_rows(5, TASKS, JUDGED, eval_seeds=3),
    *_without_fallback(_rows(5, TASKS, JUDGED, eval_seeds=3)),
    *_rows(2, TASKS, RELEASES, split="eval-2"),
    *_rows(3, TASKS, ("rl", "stop", "guarded"), SMALL, episodes=50),
    *_rows(3, SET_TABLE, TRAINED, LEVERS, episodes=50),
    *_rows(4, TASKS, ("rl", "stop", "ik"), (0.0,), "open", "val", episodes=50),
)
SMOKE_ROWS = (
    *_rows(1, TASKS[:2], ("rl", "ik"), (0.0,), "open"),
    *_rows(1, SET_TABLE, ("rl", "ik"), (0.0,), "closed", "val"),
)
GRIDS = {"smoke": _smaller(SMOKE_ROWS, 2, 1), "laptop": _smaller(THESIS_ROWS, 30, 3), "thesis": THESIS_ROWS}


def make_grid(scale: str, phases: Sequence[int]) -> tuple[Row, ...]:
    """Return the rows of a scale that belong to some phases; PerdureError if there are none."""
    if rows := tuple(row for row in GRIDS[scale] if row.phase in phases):
        return rows
    raise PerdureError(f"scale {scale} has no work in phases {', '.join(map(str, phases))}")
