"""The Fetch's numbers that everybody needs: names of joints, limits, the pose of rest."""

from __future__ import annotations

import math

from perdure.home.sim.robot.links import ARM, FINGERS, TORSO

BASE_JOINTS = ("base_x", "base_y", "base_yaw")
"""Slides along the room's x and y in [m], then the heading in [rad]."""
TORSO_JOINT = TORSO.joint
ARM_JOINTS = tuple(link.joint for link in ARM)
"""The seven joints of the arm, from the shoulder to the wrist."""
FINGER_JOINTS = tuple(link.joint for link in FINGERS)
JOINTS = (*BASE_JOINTS, TORSO_JOINT, *ARM_JOINTS, *FINGER_JOINTS)
"""All joints and all actuators, in the order of the model."""

ARM_LOW = tuple(-math.inf if link.limit is None else link.limit[0] for link in ARM)
ARM_HIGH = tuple(math.inf if link.limit is None else link.limit[1] for link in ARM)
"""Limits of the arm in [rad] (URDF); the three rolls turn without end."""
ROLLS = [number for number, link in enumerate(ARM) if link.limit is None]
"""Joints of the arm that turn without end."""
BASE_RADIUS = 0.285
"""Of the base, a cylinder, in [m]."""
TORSO_HEIGHT = 0.15
"""Where the benchmark keeps the torso in [m] (M3, habitat-lab: `torso_lift_joint` pinned each step)."""

OPEN, CLOSED = 0.04, 0.0
"""Positions of each finger in [m]: M3's open gripper; the fingers' faces meet."""

REST_POSITION = (0.5, 0.0, 1.0)
"""Where the gripper rests in the base frame in [m] (M3 and habitat-lab: resting position)."""
# M3's initial pose (-.268, -1.133, .367, 1.081, .06, 2.002, .067) brings `gripper_link` there to the millimeter and the
# gripper point 1 cm above; from it inverse kinematics found this one, with the same direction of the fingers.
REST_ARM = (-0.270325, -1.141013, 0.369315, 1.122742, 0.061235, 1.968084, 0.065927)
"""Joint angles of the arm at rest in [rad]."""
