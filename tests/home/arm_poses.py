"""Arm poses for scenes: searched from several starts, with a wanted rotation, approach direction or neither."""

from collections import namedtuple

import numpy as np

from perdure.home.sim import kinematics
from perdure.home.sim.robot import ROBOT

STARTS = (
    ROBOT.rest_arm,
    (0.0, 0.6, 0.0, 0.8, 0.0, 0.4, 0.0),
    (0.8, -0.6, 1.2, 1.6, -0.8, 1.2, 1.0),
    (-0.8, -0.6, -1.2, 1.6, 0.8, 1.2, -1.0),
    (0.0, 0.9, 3.0, 1.2, 3.0, 1.2, 0.0),
)
Reached = namedtuple("Reached", "arm ok error")


def reach(position, start=ROBOT.rest_arm, rotation=None, approach=None):
    """The first pose within 0.1 mm and 1 mrad, else the one with the smallest error."""
    position, found = np.asarray(position), []
    for each in dict.fromkeys((tuple(start), *map(tuple, STARTS))):
        begin = np.asarray(each, dtype=np.float64)
        if rotation is not None:
            arm, way, turn = kinematics.reach(position, np.asarray(rotation), begin)
        elif approach is not None:
            direction = np.asarray(approach) / np.linalg.norm(approach)
            arms, ways, turns = kinematics.reach_many(position[None], direction[None], None, begin, 200)
            arm, way, turn = arms[0], ways[0], turns[0]
        else:
            arm, turn = begin, 0.0
            for _ in range(100):
                point, _, jacobian = kinematics.pose_and_jacobian(ROBOT.torso_height, arm)
                step = kinematics.damped_step(jacobian[:3], position - point, 0.05)
                arm = np.clip(arm + np.clip(step, -0.3, 0.3), ROBOT.arm_low, ROBOT.arm_high)
            way = np.linalg.norm(position - kinematics.gripper_pose(ROBOT.torso_height, arm)[0])
        if way <= 1e-4 and turn <= 1e-3:
            return Reached(arm, True, way)
        found.append((way + 0.5 * turn, tuple(arm)))
    error, arm = min(found)
    return Reached(np.array(arm), False, error)
