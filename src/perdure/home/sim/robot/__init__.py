"""The Fetch: a robot of 121 kg that drives, lifts, reaches with seven joints and holds with two fingers.

Contents:
    add_fetch                       the robot in a MuJoCo specification, with servos, cameras and visuals
    gripper_pose, pose_and_jacobian forward kinematics in NumPy, for many robots at once
    reach, reach_many, toward       inverse kinematics: one pose, many poses, one small straight step
    JOINTS, ARM_JOINTS, REST_ARM... names, limits, the pose of rest
"""

from perdure.home.sim.robot.data import (
    ARM_HIGH,
    ARM_JOINTS,
    ARM_LOW,
    FINGER_JOINTS,
    JOINTS,
    REST_ARM,
    REST_POSITION,
    TORSO_HEIGHT,
    TORSO_JOINT,
)
from perdure.home.sim.robot.fetch import add_fetch
from perdure.home.sim.robot.inverse import Reach, reach, reach_many, rotation_vector, toward
from perdure.home.sim.robot.kinematics import gripper_pose, pose_and_jacobian
from perdure.home.sim.robot.links import GRIPPER_POINT

__all__ = [
    "ARM_HIGH",
    "ARM_JOINTS",
    "ARM_LOW",
    "FINGER_JOINTS",
    "GRIPPER_POINT",
    "JOINTS",
    "REST_ARM",
    "REST_POSITION",
    "TORSO_HEIGHT",
    "TORSO_JOINT",
    "Reach",
    "add_fetch",
    "gripper_pose",
    "pose_and_jacobian",
    "reach",
    "reach_many",
    "rotation_vector",
    "toward",
]
