"""The action of a control step: eleven numbers from -1 to 1, M3's mobile manipulation and "stop"."""

from __future__ import annotations

ACTION_SIZE = 11
FORWARD, TURN, ARM, GRIP, STOP = 0, 1, slice(2, 9), 9, 10
"""Where the parts stand: base forward, base turn, seven arm joints, gripper, "I am there"."""
STOP_LEVEL = 0.9
"""Above it a robot says that it has arrived, and the base stops; below 0 it denies it, 0 leaves it to the map (OURS; M3
has a discrete action for it)."""

BASE_SPEED = 1.5
"""Forward speed in [m/s] and turning speed in [rad/s] of an action of 1 in manipulation skills (M3)."""
NAVIGATION_SPEED = 3.0
"""The same in navigation (M3, whose actions are 20 discrete ones; ours are continuous)."""
ARM_STEP = 0.025
"""What an action of 1 adds to a joint's servo target in one control step, in [rad] (M3)."""
GRASP, RELEASE, LEAVE = 1.0, -1.0, 0.0
"""Gripper: above 0 grasps, below 0 releases (M3's signs; the thesis has them the other way round), 0 does nothing."""
GRASP_RADIUS = 0.15
"""How near a handle or an object's middle must be to the gripper point to be grasped, in [m] (M3, habitat-lab)."""
