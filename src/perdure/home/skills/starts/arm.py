"""Arm poses at the start of a skill: the gripper point near its rest position."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from perdure.home.sim.arrays import FloatArray
from perdure.home.sim.robot import gripper_pose, toward
from perdure.home.sim.robot.data import REST_ARM, REST_POSITION, TORSO_HEIGHT

SPREAD, FARTHEST = 0.025, 0.05
"""Noise of the gripper point per axis in [m]: standard deviation and clip (M3)."""
BANK = 1024
"""Number of poses that are solved once; start states draw from them (OURS)."""
REACHED = 0.001
"""Largest error per axis of a solved pose in [m]."""


def draw_arm(rng: np.random.Generator) -> FloatArray:
    """Draw joint angles with the gripper point at rest plus N(0, 0.025 m) per axis, clipped at 0.05 m. Shape (7,)."""
    poses = bank()
    return np.asarray(poses[int(rng.integers(len(poses)))])


@lru_cache(maxsize=1)
def bank() -> FloatArray:
    """Return poses with the gripper oriented as at rest, without those beyond the wrist's limit. Shape (<= BANK, 7)."""
    rng = np.random.Generator(np.random.PCG64(0))
    points = np.asarray(REST_POSITION) + np.clip(rng.normal(0.0, SPREAD, (BANK, 3)), -FARTHEST, FARTHEST)
    arm = np.tile(REST_ARM, (BANK, 1))
    upright = gripper_pose(TORSO_HEIGHT, np.asarray(REST_ARM))[1]
    for _ in range(30):
        arm = arm + toward(arm, points - gripper_pose(TORSO_HEIGHT, arm)[0], rotation=upright, largest=0.2)
    reached = np.abs(points - gripper_pose(TORSO_HEIGHT, arm)[0]).max(axis=1) < REACHED
    found: FloatArray = arm[reached]
    found.flags.writeable = False
    return found
