"""Reset the arm: bring its joints to the pose of rest. Scripted, as in the benchmark."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from perdure.home.sim.robot.data import REST_ARM, ROLLS
from perdure.home.sim.world import ACTION_SIZE, ARM, PrivilegedState
from perdure.home.skills.observation import PROPRIOCEPTION, proprioception
from perdure.home.skills.skill import Element, Progress, Skill

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

DONE = 0.05
"""Largest joint error in [rad] at which the arm is reset (habitat-lab)."""
FASTEST = 0.1
"""Largest change of a joint's target in a step in [rad] (M3)."""


@dataclass(frozen=True)
class ResetArm(Skill):
    """No reward of its own: nobody learns it."""

    name = "reset_arm"
    arm_step = FASTEST
    failures = ("none",)
    scan_reach = 0.0

    @property
    def elements(self) -> tuple[Element, ...]:
        """See `Skill.elements`."""
        return PROPRIOCEPTION

    def observe(self, state: PrivilegedState, progress: Progress) -> FloatArray:
        """See `Skill.observe`."""
        return np.concatenate(proprioception(state), axis=1)

    def terms(
        self, before: PrivilegedState, after: PrivilegedState, was: Progress, now: Progress
    ) -> Mapping[str, FloatArray]:
        """See `Skill.terms`."""
        return {}

    def success(self, state: PrivilegedState, progress: Progress) -> BoolArray:
        """All joints are within 0.05 rad of rest."""
        done: BoolArray = np.abs(rest_error(state.arm)).max(axis=1) < DONE
        return done

    def stop(self, state: PrivilegedState, progress: Progress) -> BoolArray:
        """The same."""
        return self.success(state, progress)

    def act(self, state: PrivilegedState) -> FloatArray:
        """Every joint straight to rest, at most 0.1 rad in a step. Shape (n, 11)."""
        actions = np.zeros((len(state), ACTION_SIZE))
        actions[:, ARM] = np.clip(rest_error(state.arm_target) / FASTEST, -1.0, 1.0)
        return actions


def rest_error(arm: FloatArray) -> FloatArray:
    """From joint angles to rest; rolls go the shorter way round. Shape (n, 7)."""
    error = np.asarray(REST_ARM) - arm
    for column in ROLLS:
        error[:, column] = np.mod(error[:, column] + np.pi, 2.0 * np.pi) - np.pi
    return error
