"""Who acts while a skill runs: a learned policy, the oracle, a scripted motion, a hand-over."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from perdure.home.sim.world import PrivilegedState, World
from perdure.home.skills import Progress, Skill

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


class Actor(Protocol):
    """Acts for some lanes at a time. What it remembers of a lane, it keeps under the lane's number."""

    @property
    def sees(self) -> bool:
        """Whether it wants the scan and the target's neighbors where the skill has them."""

    def begin(self, world: World, lane: int, skill: Skill) -> None:
        """A lane starts a skill; its skill_goal is set."""

    def act(
        self, world: World, lanes: IntArray, skill: Skill, state: PrivilegedState, progress: Progress
    ) -> FloatArray:
        """Actions for these lanes, rows of `state` and `progress`. Shape (len(lanes), 11)."""

    def overtime(self, lane: int) -> bool:
        """Whether a lane needs more time than the skill's limit, to put down what it holds."""


class Scripted:
    """Acts for skills that bring their own motion (`reset_arm`)."""

    sees = False

    def begin(self, world: World, lane: int, skill: Skill) -> None:
        """Nothing to remember."""

    def act(
        self, world: World, lanes: IntArray, skill: Skill, state: PrivilegedState, progress: Progress
    ) -> FloatArray:
        """See `Actor.act`."""
        from perdure.home.skills import ResetArm

        assert isinstance(skill, ResetArm)
        return skill.act(state)

    def overtime(self, lane: int) -> bool:
        """Never needs more time."""
        return False
