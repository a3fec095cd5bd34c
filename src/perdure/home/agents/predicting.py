"""Anybody's policy as an actor: a function from a skill's observations to its actions."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from perdure.home.errors import HomeError
from perdure.home.sim.world import PrivilegedState, World
from perdure.home.skills import Progress, Skill

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


class Predicting:
    """Acts with a function, such as another library's policy, in any one skill.

    It gets what the skill's Gymnasium environment shows and gives what that takes; a policy with a memory needs an
    `Actor` of its own. A lane's course is independent of the others as far as the function's rows are.
    """

    sees = True

    def __init__(self, predict: Callable[[FloatArray], ArrayLike]) -> None:
        """Takes the function.

        Args:
            predict: Observations, shape (n, observation size), to actions, shape (n, action size): 10, for navigation
                2. Values outside -1 to 1 are clipped. n changes from call to call.
        """
        self.predict = predict

    def begin(self, world: World, lane: int, skill: Skill) -> None:
        """Nothing to remember."""

    def act(
        self, world: World, lanes: IntArray, skill: Skill, state: PrivilegedState, progress: Progress
    ) -> FloatArray:
        """See `Actor.act`. HomeError if the function gives another shape than it must."""
        actions = np.asarray(self.predict(skill.observe(state, progress)), dtype=np.float64)
        shape = len(lanes), len(skill.active_columns)
        if actions.shape != shape:
            raise HomeError(f"predict gave actions of shape {actions.shape} for {skill.name}; it must be {shape}")
        return skill.expand_action(actions)

    def overtime(self, lane: int) -> bool:
        """Never needs more time."""
        return False
