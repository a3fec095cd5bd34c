"""What is kept of an executed episode: every event, and where everything was at every step."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from perdure.home.benchmark.episodes import Episode
from perdure.home.benchmark.tasks import WorldFacts

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]

Ending = Literal["stopped", "timed out", "task limit"]


@dataclass(frozen=True)
class SkillRun:
    """One step of the plan as it went."""

    number: int
    """Position in the plan, from 0."""
    skill: str
    target: int
    begin: int
    """Control steps of the episode before it."""
    end: int
    """Control steps of the episode after it."""
    ending: Ending
    success: bool
    """Whether the skill's own success condition held in its last step."""
    forced_release: bool = False
    """Whether the executor opened the hand after a time-out."""


@dataclass(frozen=True)
class EpisodeLog:
    """An executed episode, and the settling time after it."""

    episode: Episode
    eval_seed: int
    skills: tuple[SkillRun, ...]
    steps: int
    """Control steps until the plan or the task's limit ended; the arrays below go on for the settling time."""
    facts: WorldFacts
    """Targets, held, drawer, fridge at every step. Leading axis (steps + settling time)."""
    active: IntArray
    """Number of the plan's step that was running, the plan's length in the settling time. Shape (steps + settling
    time,)."""
    base: FloatArray
    """Base in the room: x, y, heading. Shape (steps + settling time, 3)."""
    gripper: FloatArray
    """Gripper point in the room. Shape (steps + settling time, 3)."""
    object_up: FloatArray
    """Height of the targets' own z axes: 1 upright, 0 lying. Shape (steps + settling time, targets)."""
    object_speed: FloatArray
    """Speed of the targets in [m/s]. Shape (steps + settling time, targets)."""
    contact_force: FloatArray
    """Largest normal force at the robot in [N]. Shape (steps + settling time,)."""
    latched: BoolArray
    """Which stages were reached, as the benchmark counts. Shape (stages,)."""
    diverged: bool
    """Whether the simulation blew up: nothing after that counts."""
    final_poses: FloatArray
    """Position and quaternion (w, x, y, z) of every object, clutter too, after the last step. Shape (objects, 7)."""
    final_speeds: FloatArray
    """Their speeds in [m/s]. Shape (objects,)."""
    final_held: int
    """Number of the object in the hand after the last step, -1 for none."""


class Recorder:
    """Collects the arrays of an `EpisodeLog` step by step: the columns of a step are kept as one row."""

    def __init__(self, targets: int) -> None:
        """For an episode with so many targets."""
        self._rows: list[FloatArray] = []
        self._targets = targets

    @staticmethod
    def table(*columns: FloatArray | IntArray) -> FloatArray:
        """Rows of m lanes from columns (m, ...), in the order of `arrays`. Shape (m, width)."""
        return np.concatenate([each.reshape(len(each), -1) for each in columns], axis=1, dtype=np.float64)

    def add(self, row: FloatArray) -> None:
        """Keeps one lane's row of a `table`."""
        self._rows.append(row)

    def arrays(self) -> tuple[FloatArray, ...]:
        """The columns again, steps first.

        Returns:
            Positions of the targets (n, targets, 3), held, drawer, fridge, active (n,), base and gripper (n, 3), up and
            speed of the targets (n, targets), force (n,).
        """
        targets = self._targets
        shapes = ((targets, 3), (), (), (), (), (3,), (3,), (targets,), (targets,), ())
        ends = np.cumsum([np.prod(shape, dtype=np.int64) for shape in shapes])
        columns = np.split(np.array(self._rows), ends[:-1], axis=1)
        return tuple(each.reshape(len(each), *shape) for each, shape in zip(columns, shapes, strict=True))
