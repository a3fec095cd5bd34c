"""What a learner may tell the robot in each skill, and how it becomes the robot's ten numbers."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from perdure.home.sim.world import ACTION_SIZE, ARM, FORWARD, GRIP, TURN
from perdure.home.skills.skill import Skill

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

NAMES: tuple[str, ...] = ("forward", "turn", *(f"arm_{k}" for k in range(ARM.stop - ARM.start)), "grip", "stop")
"""The robot's eleven numbers, all from -1 to 1."""


def used(skill: Skill) -> IntArray:
    """Which of them a skill uses: navigation drives only. Shape (m,)."""
    return np.array([FORWARD, TURN]) if skill.name == "navigate" else np.arange(GRIP + 1)


def whole(actions: FloatArray, columns: IntArray) -> FloatArray:
    """All numbers from those that are used, the others 0. Shape (n, m) -> (n, 11)."""
    everything = np.zeros((len(actions), ACTION_SIZE))
    everything[:, columns] = actions
    return everything
