"""The oracle as an agent: for each lane a motion that it continues step by step."""

from __future__ import annotations

import numpy as np

from perdure.home.agents.oracle.articulate import articulate
from perdure.home.agents.oracle.motions import Motion, View
from perdure.home.agents.oracle.navigate import navigate
from perdure.home.agents.oracle.pick import pick
from perdure.home.agents.oracle.place import place
from perdure.home.agents.skill_agent import SkillAgent
from perdure.home.sim.arrays import FloatArray, IntArray
from perdure.home.sim.world import ACTION_SIZE, STOP, PrivilegedState, VectorSimulator
from perdure.home.skills import Skill, SkillProgress

MOVES = {
    "open_drawer": (0.45, 0.02),
    "close_drawer": (0.0, 0.02),
    "open_fridge": (1.55, 0.05),
    "close_fridge": (0.0, 0.05),
}
"""Goal position of drawers and doors, and its tolerance, in [m] or [rad]."""


class Oracle(SkillAgent):
    """Sense, plan, act with full knowledge of the world: geodesic paths and inverse kinematics."""

    sees = False

    def __init__(self) -> None:
        """Start without plans; a plan is made when a skill begins."""
        self._motions: dict[int, Motion | None] = {}
        self._views: dict[int, View] = {}

    def begin(self, world: VectorSimulator, lane: int, skill: Skill) -> None:
        """See `SkillAgent.begin`."""
        view = View(world.sense(np.array([lane])), world, lane, skill.base_speed)
        self._views[lane] = view
        self._motions[lane] = self._motion(view, skill)

    def act(
        self, world: VectorSimulator, lanes: IntArray, skill: Skill, state: PrivilegedState, progress: SkillProgress
    ) -> FloatArray:
        """See `SkillAgent.act`. After the end of a motion the robot stands still, or signals "stop"."""
        actions = np.zeros((len(lanes), ACTION_SIZE))
        for row, lane in enumerate(lanes):
            number = int(lane)
            self._views[number].state = state[row : row + 1]
            motion = self._motions[number]
            if motion is not None:
                try:
                    actions[row] = next(motion)
                    actions[row, STOP] = -1.0  # it knows better than the map where to stop
                    continue
                except StopIteration:
                    self._motions[number] = None
            actions[row, STOP] = float(skill.name == "navigate")
        return actions

    def _motion(self, view: View, skill: Skill) -> Motion:
        if skill.name == "pick":
            return pick(view)
        if skill.name == "place":
            return place(view)
        if skill.name == "navigate":
            return navigate(view)
        return articulate(view, *MOVES[skill.name])
