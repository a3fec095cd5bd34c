"""Reset the arm: bring its joints to the pose of rest. Scripted, as in the benchmark."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from perdure.home.sim.robot.data import REST_ARM, ROLLS
from perdure.home.sim.world import ACTION_SIZE, ARM, PrivilegedState
from perdure.home.sim.world.state import wrap
from perdure.home.skills.observation import PROPRIOCEPTION
from perdure.home.skills.skill import BoolArray, FloatArray, Skill, SkillProgress

DONE = 0.05
"""Largest joint error of a reset arm in [rad] (habitat-lab)."""
FASTEST = 0.1
"""Largest change of a joint's servo target in a step in [rad] (M3)."""


@dataclass(frozen=True)
class ResetArm(Skill):
    """A scripted skill: it has no reward and no recipe."""

    name = "reset_arm"
    step_limit = 50
    observation = (PROPRIOCEPTION,)
    success_text = f"all joints are within {DONE:g} rad of rest"
    arm_step = FASTEST
    scan_reach = 0.0

    def success(self, state: PrivilegedState, progress: SkillProgress) -> BoolArray:
        """See `success_text`."""
        return np.asarray(np.abs(rest_error(state.arm)).max(axis=1) < DONE)

    def act(self, state: PrivilegedState) -> FloatArray:
        """Return actions that move every joint straight to rest, at most 0.1 rad in a step. Shape (n, 11)."""
        actions = np.zeros((len(state), ACTION_SIZE))
        actions[:, ARM] = np.clip(rest_error(state.arm_target) / FASTEST, -1.0, 1.0)
        return actions


def rest_error(arm: FloatArray) -> FloatArray:
    """Return joint angles of rest minus `arm`, the shorter way round for unlimited joints. Shape (n, 7)."""
    error = np.asarray(REST_ARM) - arm
    error[:, ROLLS] = wrap(error[:, ROLLS])
    return error
