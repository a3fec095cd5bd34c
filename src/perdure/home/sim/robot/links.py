"""The Fetch's bodies: where they sit, how they move, how heavy they are.

Every number is from Fetch Robotics' own `fetch_description/robots/fetch.urdf` (fetch_ros, commit 0dbc193), in which all
link frames are parallel when the joints are at 0: x forward, y left, z up. Left out: the bellows, emergency stop and
laser (0.35 kg together). Rigidly attached parts (wheels, fixed torso, head) are one body with what carries them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from perdure.home.sim.arrays import FloatArray, Vec3

Vec6 = tuple[float, float, float, float, float, float]

HEAD_TILT = 0.332
"""How far the head looks down in [rad]: M3's head camera looks from (0.17, 0, 1.2) to (0.75, 0, 1.0)."""
HEAD_PAN_ORIGIN: Vec3 = (0.053125, 0.0, 0.603001)
HEAD_TILT_ORIGIN: Vec3 = (0.195655, 0.0, 0.661)
"""The head's two axes in the torso's frame in [m]."""


@dataclass(frozen=True)
class Inertial:
    """Mass in [kg], center of mass in [m], moments about it (xx, yy, zz, xy, xz, yz) in [kg m^2]."""

    mass: float
    center: Vec3
    moments: Vec6


@dataclass(frozen=True)
class Link:
    """One moving body and the joint that carries it."""

    body: str
    parent: str
    joint: str
    kind: Literal["hinge", "slide"]
    axis: Vec3
    origin: Vec3
    """The joint in the parent's frame in [m]."""
    limit: tuple[float, float] | None
    """Range in [rad] or [m], None for a continuous joint."""
    effort: float
    """Largest torque in [N m] or force in [N]."""
    parts: tuple[Inertial, ...]
    """What it weighs, in its own frame."""


def _shifted(by: Vec3, part: Inertial) -> Inertial:
    x, y, z = (a + b for a, b in zip(by, part.center, strict=True))
    return Inertial(part.mass, (x, y, z), part.moments)


_WHEEL = Inertial(4.3542, (0.0, 0.0, 0.0), (0.0045, 0.005, 0.0045, 0.0, 0.0, 0.0))
_TORSO_FIXED = Inertial(13.2775, (-0.0722, 0.0057, 0.2656), (0.3861, 0.3388, 0.1018, 0.0015, -0.0102, 0.0117))
BASE_PARTS = (
    Inertial(70.1294, (-0.0036, 0.0, 0.0014), (1.225, 1.2853, 0.987, 0.0099, 0.0062, -0.0034)),
    _shifted((0.0012914, 0.18738, 0.055325), _WHEEL),
    _shifted((0.0012914, -0.18738, 0.055325), _WHEEL),
    _shifted((-0.086875, 0.0, 0.377425), _TORSO_FIXED),
)
"""The base, its wheels and the fixed part of the torso, in the base frame."""

_TORSO_PARTS = (
    Inertial(10.7796, (-0.0013, -0.0009, 0.2935), (0.3354, 0.3354, 0.0954, 0.0, -0.0162, -0.0006)),
    _shifted(HEAD_PAN_ORIGIN, Inertial(2.2556, (0.0321, 0.0161, 0.039), (0.0129, 0.0095, 0.0184, 0.0002, 0.0007, 0.0))),
    _shifted(HEAD_TILT_ORIGIN, Inertial(0.9087, (0.0081, 0.0025, 0.0113), (0.0061, 0.0014, 0.0061, 0.0, 0.0002, 0.0))),
)
_GRIPPER = Inertial(1.5175, (-0.09, -0.0001, -0.0017), (0.0013, 0.0019, 0.0024, 0.0, 0.0, 0.0))
# The URDF's finger has moments (0.002, 0, 0), which no body can have; these are those of the finger's box.
_FINGER = Inertial(0.0798, (-0.01, 0.0, 0.0), (6.3e-6, 2.88e-5, 2.54e-5, 0.0, 0.0, 0.0))

GRIPPER_ORIGIN: Vec3 = (0.16645, 0.0, 0.0)
"""`gripper_link` in the frame of `wrist_roll_link`, to which it is fixed."""
GRIPPER_POINT: Vec3 = (-0.01, -0.0001, -0.0017)
"""M3's gripper point in the frame of `gripper_link` in [m]: what is near or far, and what a held object hangs on."""
GRIPPER_PARTS = (_GRIPPER,)

_X, _Y, _Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)

TORSO = Link(
    "torso_lift_link",
    "robot",
    "torso_lift_joint",
    "slide",
    _Z,
    (-0.086875, 0.0, 0.37743),
    (0.0, 0.38615),
    450.0,
    _TORSO_PARTS,
)
_ARM_PARTS = {
    "shoulder_pan": Inertial(2.5587, (0.0927, -0.0056, 0.0564), (0.0043, 0.0087, 0.0087, -0.0001, 0.001, -0.0001)),
    "shoulder_lift": Inertial(2.6615, (0.1432, 0.0072, -0.0001), (0.0028, 0.0111, 0.0112, -0.0021, 0.0, 0.0)),
    "upperarm_roll": Inertial(2.3311, (0.1165, 0.0014, 0.0), (0.0019, 0.0045, 0.0047, -0.0001, 0.0, 0.0)),
    "elbow_flex": Inertial(2.1299, (0.1279, 0.0073, 0.0), (0.0024, 0.0082, 0.0084, -0.0016, 0.0, 0.0)),
    "forearm_roll": Inertial(1.6563, (0.1097, -0.0266, 0.0), (0.0016, 0.003, 0.0035, -0.0003, 0.0, 0.0)),
    "wrist_flex": Inertial(1.725, (0.0882, 0.0009, -0.0001), (0.0018, 0.0042, 0.0042, -0.0001, 0.0, 0.0)),
    "wrist_roll": Inertial(0.1354, (0.0095, 0.0004, -0.0002), (0.0001, 0.0001, 0.0001, 0.0, 0.0, 0.0)),
}
ARM = tuple(
    Link(f"{name}_link", f"{parent}_link", f"{name}_joint", "hinge", axis, origin, limit, effort, (_ARM_PARTS[name],))
    for name, parent, axis, origin, limit, effort in (
        ("shoulder_pan", "torso_lift", _Z, (0.119525, 0.0, 0.34858), (-1.6056, 1.6056), 33.82),
        ("shoulder_lift", "shoulder_pan", _Y, (0.117, 0.0, 0.06), (-1.221, 1.518), 131.76),
        ("upperarm_roll", "shoulder_lift", _X, (0.219, 0.0, 0.0), None, 76.94),
        ("elbow_flex", "upperarm_roll", _Y, (0.133, 0.0, 0.0), (-2.251, 2.251), 66.18),
        ("forearm_roll", "elbow_flex", _X, (0.197, 0.0, 0.0), None, 29.35),
        ("wrist_flex", "forearm_roll", _Y, (0.1245, 0.0, 0.0), (-2.16, 2.16), 25.7),
        ("wrist_roll", "wrist_flex", _X, (0.1385, 0.0, 0.0), None, 7.36),
    )
)
"""The seven links of the arm, from the shoulder to the wrist."""


def _finger(side: str, sign: float) -> Link:
    return Link(
        f"{side}_gripper_finger_link",
        "gripper_link",
        f"{side}_gripper_finger_joint",
        "slide",
        (0.0, sign, 0.0),
        (0.0, sign * 0.015425, 0.0),
        (0.0, 0.05),
        60.0,
        (_FINGER,),
    )


FINGERS = (_finger("l", -1.0), _finger("r", 1.0))
"""The two fingers. As in the URDF, `l` is on the side of -y."""


def combined(parts: tuple[Inertial, ...]) -> Inertial:
    """Return mass, center and moments of several rigidly joined parts (parallel axis theorem)."""
    mass = sum(part.mass for part in parts)
    center: FloatArray = np.sum([part.mass * np.array(part.center) for part in parts], axis=0) / mass
    tensor = np.zeros((3, 3))
    for part in parts:
        xx, yy, zz, xy, xz, yz = part.moments
        arm = np.array(part.center) - center
        tensor += [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]
        tensor += part.mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    x, y, z = center.tolist()
    xx, yy, zz = np.diag(tensor).tolist()
    return Inertial(mass, (x, y, z), (xx, yy, zz, float(tensor[0, 1]), float(tensor[0, 2]), float(tensor[1, 2])))
