"""How the arm is held when a skill begins: the gripper near its rest position."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from perdure.home.sim.robot import gripper_pose, toward
from perdure.home.sim.robot.data import REST_ARM, REST_POSITION, TORSO_HEIGHT

FloatArray = NDArray[np.float64]

SPREAD, FARTHEST = 0.025, 0.05
"""Of the gripper point per axis in [m]: standard deviation and cut (M3)."""
BANK = 1024
"""OURS: so many poses are solved once, and starts draw among them."""
REACHED = 0.001
"""Error per axis in [m] up to which a pose counts as solved."""


def draw_arm(rng: np.random.Generator) -> FloatArray:
    """Joint angles whose gripper point is at rest plus N(0, 0.025 m), cut at 0.05 m, per axis. Shape (7,)."""
    poses = bank()
    one: FloatArray = poses[int(rng.integers(len(poses)))]
    return one


@lru_cache(maxsize=1)
def bank() -> FloatArray:
    """The poses, the gripper turned as at rest, those left out that the wrist's limit forbids. Shape (<= BANK, 7)."""
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
