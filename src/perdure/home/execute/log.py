"""What is kept of an executed episode: every event, and where everything was at every step."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from perdure.home.episodes import Episode
from perdure.home.tasks import WorldFacts

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


@dataclass
class Recorder:
    """Collects an `EpisodeLog` step by step."""

    rows: list[tuple[FloatArray, int, float, float, int, FloatArray, FloatArray, FloatArray, FloatArray, float]] = (
        field(default_factory=list)
    )

    def arrays(self) -> list[NDArray[np.generic]]:
        """The columns, one array each, steps first."""
        return [np.array(column) for column in zip(*self.rows, strict=True)]
