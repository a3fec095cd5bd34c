"""Geom groups and collision bits that robot, apartments and objects share."""

from __future__ import annotations

from typing import Any

COLLIDES_AND_SEEN = 0
WALL = 1
ONLY_SEEN = 2
ONLY_COLLIDES = 3
HIDDEN = 4
"""Geom groups. A wall collides and is seen, too; hidden are handles and the robot's bumper."""
ROBOT_BIT = 1
BUMPER_BIT = 4
OBJECT_BIT = 8
"""Collision bits: robot against room; base bumper against furniture; object against object, also while the objects
ignore the robot. Bit 2 is the robot's own, hand against body (`data/fetch.xml`)."""
FRICTION = (0.2, 0.005, 0.0001)
"""Friction of furniture and robot: low, because MuJoCo takes the larger one of a pair and the object's is to decide."""


def geom_type(shape: str) -> Any:
    """Return MuJoCo's geom type of a shape's name, such as `box`."""
    import mujoco

    return getattr(mujoco.mjtGeom, f"mjGEOM_{shape.upper()}")
