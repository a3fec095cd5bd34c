"""Interface of agents in a skill: a learned policy, the oracle, a scripted motion, a release strategy."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from perdure.home.sim.apartments import Pose
from perdure.home.sim.arrays import FloatArray, IntArray
from perdure.home.sim.world import PrivilegedState, VectorSimulator
from perdure.home.skills import Skill, SkillProgress


class SkillAgent(Protocol):
    """Acts for some lanes at a time. What it remembers of a lane, it keeps under the lane's number.

    Subclasses inherit `begin` and `overtime`, which do nothing. Any class with these members is an agent.
    """

    @property
    def sees(self) -> bool:
        """Whether it needs the scan and the target's neighbors, where the skill has them."""
        return True

    def begin(self, world: VectorSimulator, lane: int, skill: Skill) -> None:
        """Prepare a lane for a skill; its skill goal is set."""
        return

    @abstractmethod
    def act(
        self, world: VectorSimulator, lanes: IntArray, skill: Skill, state: PrivilegedState, progress: SkillProgress
    ) -> FloatArray:
        """Return actions for these lanes, rows of `state` and `progress`. Shape (len(lanes), 11)."""

    def overtime(self, lane: int) -> bool:
        """Return whether a lane needs more time than the skill's limit, to put down what it holds."""
        return False


@dataclass
class LaneView:
    """One lane during a motion; `state` (one row) is updated before each action."""

    state: PrivilegedState

    @property
    def base(self) -> Pose:
        """Base pose."""
        x, y, yaw = (float(value) for value in self.state.base[0])
        return Pose(x, y, yaw)

    @property
    def arm(self) -> FloatArray:
        """Targets of the arm's servos in [rad]. Shape (7,)."""
        return np.asarray(self.state.arm_target[0])


class Scripted(SkillAgent):
    """Acts in skills that bring their own motion (`reset_arm`)."""

    sees = False

    def act(
        self, world: VectorSimulator, lanes: IntArray, skill: Skill, state: PrivilegedState, progress: SkillProgress
    ) -> FloatArray:
        """See `SkillAgent.act`."""
        from perdure.home.skills import ResetArm

        assert isinstance(skill, ResetArm)
        return skill.act(state)
