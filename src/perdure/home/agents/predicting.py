"""A policy of any library as an agent: a function from a skill's observations to its actions."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from perdure.home.agents.skill_agent import SkillAgent
from perdure.home.errors import HomeError
from perdure.home.sim.arrays import FloatArray, IntArray
from perdure.home.sim.world import PrivilegedState, VectorSimulator
from perdure.home.skills import Skill, SkillProgress


class Predicting(SkillAgent):
    """Acts with a function, such as another library's policy, in any one skill.

    Observations and actions are those of the skill's Gymnasium environment. A policy with memory needs its own
    `SkillAgent`. Lanes are independent if the rows of the function are.
    """

    def __init__(self, predict: Callable[[FloatArray], ArrayLike]) -> None:
        """Keep the function.

        Args:
            predict: Observations, shape (n, observation size), to actions, shape (n, action size): 10, for navigation
                2. Values outside -1 to 1 are clipped. n changes from call to call.
        """
        self.predict = predict

    def act(
        self, world: VectorSimulator, lanes: IntArray, skill: Skill, state: PrivilegedState, progress: SkillProgress
    ) -> FloatArray:
        """See `SkillAgent.act`. HomeError if the function returns a wrong shape."""
        actions = np.asarray(self.predict(skill.observe(state, progress)), dtype=np.float64)
        shape = len(lanes), len(skill.active_columns)
        if actions.shape != shape:
            raise HomeError(f"predict gave actions of shape {actions.shape} for {skill.name}; it must be {shape}")
        return skill.expand_action(actions)
