"""Collision geometry of the Fetch: eleven boxes, cylinders and capsules, sized like the URDF's collision meshes.

Contacts. The robot meets furniture, floor and objects, but not itself, with one exception: the links
after the elbow carry a second bit and meet base, torso and head, so that the hand cannot pass through the body.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from perdure.home.sim.arrays import Vec3


@dataclass(frozen=True)
class CollisionShape:
    """One primitive in the frame of its body; sizes in [m]."""

    body: str
    name: str
    kind: Literal["box", "cylinder", "capsule"]
    center: Vec3
    half: Vec3
    """Box: half extents. Cylinder and capsule: (radius, half length, 0) along z, or along x for an arm's capsule."""
    side: Literal["body", "arm", "hand"]


TUBE = 0.052
"""Radius of the arm in [m]."""


def _tube(body: str, name: str, start: float, end: float, z: float = 0.0, hand: bool = False) -> CollisionShape:
    """Return a capsule along x whose axis runs from `start` to `end`."""
    center, half = (0.5 * (start + end), 0.0, z), (TUBE, 0.5 * (end - start), 0.0)
    return CollisionShape(body, name, "capsule", center, half, "hand" if hand else "arm")


SHAPES = (
    # The base keeps 4 cm above the floor: it slides on its joints, not on contacts.
    CollisionShape("robot", "base", "cylinder", (0.0, 0.0, 0.2), (0.285, 0.16, 0.0), "body"),
    CollisionShape("robot", "column", "box", (-0.1, 0.0, 0.48), (0.11, 0.15, 0.12), "body"),
    CollisionShape("torso_lift_link", "torso", "box", (0.0, 0.0, 0.29), (0.123, 0.1735, 0.2865), "body"),
    CollisionShape("torso_lift_link", "head", "box", (0.145, 0.0, 0.655), (0.11, 0.12, 0.055), "body"),
    _tube("shoulder_pan_link", "shoulder", 0.03, 0.117, 0.06),
    _tube("shoulder_lift_link", "upperarm", 0.0, 0.352),
    _tube("elbow_flex_link", "forearm", 0.0, 0.3215, hand=True),
    _tube("wrist_flex_link", "wrist", 0.0, 0.12, hand=True),
    CollisionShape("gripper_link", "palm", "box", (-0.093, 0.0, 0.0), (0.061, 0.063, 0.04), "hand"),
    # The faces of closed fingers are 0.6 mm apart.
    CollisionShape("l_gripper_finger_link", "l_finger", "box", (0.0, 0.0077, 0.0), (0.03, 0.0074, 0.0135), "hand"),
    CollisionShape("r_gripper_finger_link", "r_finger", "box", (0.0, -0.0077, 0.0), (0.03, 0.0074, 0.0135), "hand"),
)

ROBOT_BIT, HAND_BIT = 1, 2
"""Collision bits: everything of the robot against the room; the hand against the body."""
BITS = {"body": (ROBOT_BIT, HAND_BIT), "arm": (ROBOT_BIT, 0), "hand": (ROBOT_BIT | HAND_BIT, 0)}
"""(contype, conaffinity) of each side."""
