"""The grid of training runs and evaluations. Immutable; extend it by a line.

A *setting* is a task with a preset of hyperparameters: "HalfCheetah-v3" (RL Baselines3 Zoo, as in the thesis) or
"Hopper-v3@cleanrl" (CleanRL's; with the Zoo's settings Hopper learns to stand still).
A *row* is a setting, a method and training seeds.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

from perdure.errors import PerdureError

ZOO = "zoo"
CLEANRL = "cleanrl"
PHASES = {
    1: "the thesis' four methods on HalfCheetah, Hopper, Swimmer and Walker2d; figure 3-1",
    2: "the thesis' four methods on Ant",
    3: "controls: random horizon, fixed horizon, linear with random horizon, average reward",
    4: "ten workers, short episodes on more tasks",
    5: "Humanoid, three methods, coarser C",
}

METHODS = {
    "ppo": "discounted PPO",
    "ppo-undiscounted": "undiscounted PPO",
    "geometric": "geometric time-to-go",
    "linear": "linear time-to-go",
    "ppo-average-reward": "average-reward PPO",
    "random-horizon": "random horizon, no time-to-go",
    "geometric-fixed": "geometric time-to-go, fixed horizon",
    "ppo-short": "PPO, episodes of 200 steps",
    "linear-10-workers": "linear time-to-go, ten workers",
    "linear-random": "linear time-to-go, random horizon",
    "geometric-discounted": "geometric time-to-go with PPO's gamma",
    "ppo-gamma-0.999": "PPO, discount 0.999",
    "ppo-average-reward+action_noise-0.1": "average-reward PPO, trained under noise",
}
"""In words, in the order of tables and styles; the ninth and later share a style. Other methods have their own name."""
THESIS_METHODS = ("ppo", "ppo-undiscounted", "linear", "geometric")
CONTROLS = ("random-horizon", "geometric-fixed", "linear-random", "ppo-average-reward")
SWEPT = ("geometric", "geometric-fixed")
"""Methods whose input depends on C."""
WORKERS = ("linear-10-workers",)
LINEAR_METHODS = ("linear", "linear-random", *WORKERS)
"""Methods to which every constant C > 0 is the same input, phi = 1."""

MAIN_SETTINGS = ("Ant-v3", "HalfCheetah-v3", "Hopper-v3@cleanrl", "Swimmer-v3", "Walker2d-v3@cleanrl")
"""One setting of each task: RL Zoo's, but CleanRL's for Hopper, which stands still under RL Zoo's, and Walker2d."""
NOISY_START = ("Ant-v3",)
"""Tasks that start with a standard deviation of 1, as their runs did; the preset has had less since."""

CONSTANTS = tuple(f"constant:{c}" for c in range(0, 1001, 100))


@dataclass(frozen=True)
class Row:
    """Training runs of one method in one setting."""

    task: str
    method: str
    preset: str
    seeds: tuple[int, ...]
    phase: int
    evaluated: bool = True
    """False where only the learning curves are kept."""

    @property
    def setting(self) -> str:
        """Task and preset, such as "Hopper-v3@cleanrl"."""
        return self.task + self._preset_suffix

    @property
    def key(self) -> str:
        """Place in the stores, such as "Hopper-v3/geometric@cleanrl"."""
        return f"{self.task}/{self.method}{self._preset_suffix}"

    @property
    def _preset_suffix(self) -> str:
        if self.preset == ZOO:
            return ""
        return f"@{self.preset}"


@dataclass(frozen=True)
class Split:
    """Start states for one purpose. Splits share none."""

    name: str
    first_seed: int
    seeds: int


@dataclass(frozen=True)
class Grid:
    """A scale of the study."""

    name: str
    rows: tuple[Row, ...]
    splits: tuple[Split, ...]
    """Validation, on which C is chosen, and test, on which everything is reported."""
    steps: int
    """Test horizon."""
    swept: tuple[str, ...]
    """Clocks of the geometric method, see `perdure.evaluate.Extrapolation`."""
    training_steps: int | None = None
    """Replaces the preset's number."""

    def clocks(self, row: Row) -> tuple[str, ...]:
        """Return the clocks under which a row is evaluated; () for a method without time-to-go input."""
        if row.method in LINEAR_METHODS:
            return ("countdown", "constant:500")
        if row.method not in SWEPT:
            return ()
        if row.task.startswith("Humanoid"):  # slow to simulate
            return ("constant:100", "constant:300", "constant:500", "constant:1000", "countdown")
        if row.method != "geometric" and self.swept == ("sweep",):
            return (*CONSTANTS, "countdown")
        return self.swept

    def row(self, setting: str, method: str) -> Row | None:
        """Return the row of a setting and method; None where there is none."""
        return next((row for row in self.rows if (row.setting, row.method) == (setting, method)), None)

    @property
    def settings(self) -> tuple[str, ...]:
        """Settings in the order of the rows."""
        return tuple(dict.fromkeys(row.setting for row in self.rows))


def _rows(
    tasks: Iterable[str], preset: str, methods: Iterable[str], count: int, phase: int, without: Sequence[str] = ()
) -> tuple[Row, ...]:
    seeds = tuple(range(count))
    pairs = itertools.product(tasks, methods)
    return tuple(Row(task, method, preset, seeds, phase, method not in without) for task, method in pairs)


THESIS_ROWS = (
    *_rows(("Hopper-v3", "Walker2d-v3"), CLEANRL, THESIS_METHODS, 10, 1),
    *_rows(("HalfCheetah-v3",), ZOO, (*THESIS_METHODS, "ppo-short"), 5, 1),
    *_rows(("Swimmer-v3",), ZOO, THESIS_METHODS, 5, 1),
    *_rows(("Hopper-v3",), ZOO, THESIS_METHODS, 5, 1, without=("ppo-undiscounted", "linear")),
    *_rows(("Walker2d-v3",), ZOO, THESIS_METHODS, 5, 1),
    *_rows(("Ant-v3",), ZOO, THESIS_METHODS, 5, 2),
    *_rows(("Hopper-v3", "Walker2d-v3"), CLEANRL, CONTROLS, 3, 3),
    *_rows(("HalfCheetah-v3", "Swimmer-v3", "Ant-v3"), ZOO, CONTROLS, 3, 3),
    *_rows(("Ant-v3",), ZOO, ("ppo-short",), 3, 4),
    *_rows(("Hopper-v3", "Walker2d-v3"), CLEANRL, ("ppo-short", *WORKERS), 3, 4, without=WORKERS),
    *_rows(("HalfCheetah-v3", "Swimmer-v3", "Ant-v3"), ZOO, WORKERS, 3, 4, without=WORKERS),
    *_rows(("Humanoid-v3",), ZOO, ("ppo", "ppo-undiscounted", "geometric"), 1, 5),
)
LAPTOP_ROWS = (
    *_rows(("Hopper-v3",), CLEANRL, (*THESIS_METHODS, "random-horizon", "geometric-fixed"), 5, 1),
    *_rows(("HalfCheetah-v3",), ZOO, ("ppo", "ppo-short", "geometric"), 5, 1),
    *_rows(("Walker2d-v3",), CLEANRL, ("ppo", "ppo-undiscounted", "geometric"), 3, 1),
)
SMOKE_ROWS = _rows(("InvertedPendulum-v4",), ZOO, (*THESIS_METHODS, "ppo-short", *WORKERS, *CONTROLS), 2, 1)

_VALIDATION = Split("validation", 1000, 2)
_OTHER_CLOCKS = ("periodic:500", "countdown")
_SMOKE_CLOCKS = ("constant:100", "constant:500", *_OTHER_CLOCKS)
GRIDS = {
    grid.name: grid
    for grid in (
        Grid("smoke", SMOKE_ROWS, (_VALIDATION, Split("test", 2000, 3)), 2_000, _SMOKE_CLOCKS, training_steps=4_096),
        Grid("laptop", LAPTOP_ROWS, (_VALIDATION, Split("test", 2000, 5)), 100_000, (*CONSTANTS, *_OTHER_CLOCKS)),
        Grid("thesis", THESIS_ROWS, (_VALIDATION, Split("test", 2000, 10)), 100_000, ("sweep",)),
    )
}


def make_grid(scale: str, phases: Sequence[int]) -> Grid:
    """Return the grid of a scale with the rows of some phases; PerdureError if there is none."""
    grid = GRIDS[scale]
    rows = tuple(row for row in grid.rows if row.phase in phases)
    if not rows:
        raise PerdureError(f"scale {scale} has no work in phases {', '.join(map(str, phases))}")
    return replace(grid, rows=rows)
