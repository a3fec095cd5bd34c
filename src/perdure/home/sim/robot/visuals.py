"""Visual geometry of the Fetch: visual primitives in the colors of Fetch Robotics' URDF.

The robot's marks are the gray drum of a base with its laser's slit, the white torso before a blue column, the
arm in turns white and blue with dark joints, and the flat head with its camera bar. OURS: all shapes, drawn by eye to
the sizes of the links.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

from perdure.home.sim.arrays import Vec3
from perdure.home.sim.robot.links import HEAD_TILT, HEAD_TILT_ORIGIN

LOOK_GROUP = 2
COLORS = {
    "white": (0.94, 0.94, 0.93, 1.0),
    "shell": (0.80, 0.81, 0.82, 1.0),
    "blue": (0.086, 0.506, 0.767, 1.0),
    "gray": (0.356, 0.361, 0.376, 1.0),
    "dark": (0.16, 0.165, 0.175, 1.0),
    "black": (0.04, 0.04, 0.045, 1.0),
    "glass": (0.10, 0.16, 0.24, 1.0),
    "red": (0.80, 0.05, 0.05, 1.0),
}
"""`blue`, `gray`, `red` are the URDF's."""


@dataclass(frozen=True)
class Visual:
    """One primitive in the frame of its body; sizes in [m]."""

    body: str
    kind: Literal["box", "ellipsoid", "cylinder", "capsule"]
    color: str
    center: Vec3
    half: Vec3
    """Box and ellipsoid: half extents. Cylinder and capsule: (radius, half length, 0)."""
    axis: Literal["x", "y", "z"] = "z"
    """Of cylinder and capsule."""
    pitch: float = 0.0
    """Turn about y in [rad], downwards in front."""

    @property
    def quaternion(self) -> tuple[float, float, float, float]:
        """(w, x, y, z): the axis is turned to its place, then the pitch."""
        if self.axis == "y":  # a quarter turn about x first
            a, b = math.cos(0.5 * self.pitch) * math.sqrt(0.5), math.sin(0.5 * self.pitch) * math.sqrt(0.5)
            return a, a, b, -b
        half = 0.5 * self.pitch + (0.25 * math.pi if self.axis == "x" else 0.0)
        return math.cos(half), 0.0, math.sin(half), 0.0


def _disc(body: str, color: str, low: float, high: float, radius: float, x: float = 0.0, y: float = 0.0) -> Visual:
    """Return an upright cylinder from height `low` to `high`."""
    return Visual(body, "cylinder", color, (x, y, 0.5 * (low + high)), (radius, 0.5 * (high - low), 0.0))


def _tube(body: str, color: str, start: float, end: float, radius: float) -> Visual:
    """Return a cylinder along the arm."""
    return Visual(body, "cylinder", color, (0.5 * (start + end), 0.0, 0.0), (radius, 0.5 * (end - start), 0.0), "x")


def _hub(body: str, color: str, radius: float, half: float, x: float = 0.0, z: float = 0.0) -> Visual:
    """Return a joint's housing: a cylinder across the arm."""
    return Visual(body, "cylinder", color, (x, 0.0, z), (radius, half, 0.0), "y")


def _face(kind: Literal["box", "cylinder", "capsule"], color: str, place: Vec3, half: Vec3, axis: Any = "z") -> Visual:
    """Return a part of the tilting head, in the frame of its axis."""
    x, y, z = place
    cos, sin = math.cos(HEAD_TILT), math.sin(HEAD_TILT)
    ox, oy, oz = HEAD_TILT_ORIGIN
    center = (ox + cos * x + sin * z, oy + y, oz - sin * x + cos * z)
    return Visual("torso_lift_link", kind, color, center, half, axis, HEAD_TILT)


_BASE = (
    *(Visual("robot", "cylinder", "black", (0.0013, y, 0.058), (0.058, 0.02, 0.0), "y") for y in (-0.187, 0.187)),
    _disc("robot", "dark", 0.035, 0.075, 0.268),
    _disc("robot", "gray", 0.075, 0.225, 0.281),
    _disc("robot", "black", 0.225, 0.285, 0.255),
    _disc("robot", "gray", 0.285, 0.335, 0.281),
    Visual("robot", "ellipsoid", "shell", (0.0, 0.0, 0.335), (0.272, 0.272, 0.032)),
    _disc("robot", "glass", 0.235, 0.275, 0.035, x=0.225),
    Visual("robot", "box", "blue", (-0.168, 0.0, 0.625), (0.062, 0.125, 0.285)),
    Visual("robot", "cylinder", "blue", (-0.168, 0.0, 0.91), (0.062, 0.125, 0.0), "y"),
    Visual("robot", "box", "dark", (-0.232, 0.0, 0.60), (0.004, 0.085, 0.22)),
    Visual("robot", "cylinder", "red", (-0.1247, 0.222, 0.320), (0.022, 0.012, 0.0)),
    *(_disc("robot", "black", 0.345 + 0.03 * i, 0.366 + 0.03 * i, 0.080, x=-0.075) for i in range(12)),
    *(_disc("robot", "dark", 0.366 + 0.03 * i, 0.375 + 0.03 * i, 0.070, x=-0.075) for i in range(12)),
)
_TORSO = (
    Visual("torso_lift_link", "box", "white", (0.0, 0.0, 0.275), (0.102, 0.105, 0.225)),
    Visual("torso_lift_link", "box", "white", (0.0, 0.0, 0.275), (0.052, 0.155, 0.225)),
    *(_disc("torso_lift_link", "white", 0.05, 0.5, 0.05, x, y) for x in (-0.052, 0.052) for y in (-0.105, 0.105)),
    *(Visual("torso_lift_link", "ellipsoid", "white", (0.0, 0.0, z), (0.108, 0.162, 0.055)) for z in (0.05, 0.495)),
    _disc("torso_lift_link", "white", 0.215, 0.335, 0.098, x=0.1195),
    _disc("torso_lift_link", "dark", 0.335, 0.352, 0.082, x=0.1195),
    Visual("torso_lift_link", "box", "dark", (0.101, 0.0, 0.448), (0.003, 0.065, 0.032)),
    _disc("torso_lift_link", "dark", 0.53, 0.615, 0.055, x=0.053),
)
_HEAD = (
    Visual("torso_lift_link", "ellipsoid", "gray", (0.085, 0.0, 0.650), (0.105, 0.125, 0.052)),
    *(
        Visual("torso_lift_link", "capsule", "gray", (0.150, y, 0.656), (0.036, 0.045, 0.0), "x")
        for y in (-0.118, 0.118)
    ),
    _face("capsule", "blue", (0.0, 0.0, 0.005), (0.044, 0.075, 0.0), "y"),
    _face("box", "blue", (0.022, 0.0, 0.015), (0.026, 0.088, 0.032)),
    _face("box", "black", (0.047, 0.0, 0.0175), (0.006, 0.078, 0.021)),
    *(_face("cylinder", "glass", (0.054, y, 0.0175), (0.013, 0.004, 0.0), "x") for y in (-0.045, 0.045)),
    _face("cylinder", "shell", (0.054, 0.0, 0.0175), (0.010, 0.004, 0.0), "x"),
)
_ARM = (
    _disc("shoulder_pan_link", "white", 0.004, 0.095, 0.078),
    Visual("shoulder_pan_link", "box", "white", (0.06, 0.0, 0.052), (0.06, 0.05, 0.040)),
    _hub("shoulder_pan_link", "dark", 0.058, 0.064, 0.117, 0.06),
    _hub("shoulder_lift_link", "blue", 0.062, 0.05),
    _tube("shoulder_lift_link", "blue", 0.0, 0.195, 0.055),
    _tube("shoulder_lift_link", "dark", 0.195, 0.213, 0.047),
    _tube("upperarm_roll_link", "white", -0.006, 0.10, 0.055),
    _hub("upperarm_roll_link", "dark", 0.050, 0.062, 0.133),
    _hub("elbow_flex_link", "blue", 0.056, 0.048),
    _tube("elbow_flex_link", "blue", 0.0, 0.175, 0.052),
    _tube("elbow_flex_link", "dark", 0.175, 0.192, 0.044),
    _tube("forearm_roll_link", "white", -0.005, 0.092, 0.052),
    _hub("forearm_roll_link", "dark", 0.046, 0.058, 0.1245),
    _hub("wrist_flex_link", "blue", 0.052, 0.046),
    _tube("wrist_flex_link", "blue", 0.0, 0.115, 0.049),
    _tube("wrist_flex_link", "dark", 0.115, 0.132, 0.040),
    _tube("wrist_roll_link", "white", -0.006, 0.020, 0.045),
)
_GRIPPER = (
    Visual("gripper_link", "box", "dark", (-0.093, 0.0, 0.0), (0.055, 0.063, 0.033)),
    Visual("gripper_link", "box", "shell", (-0.098, 0.0, 0.0), (0.048, 0.052, 0.040)),
    *(Visual("gripper_link", "cylinder", "dark", (-0.040, y, 0.0), (0.033, 0.008, 0.0), "x") for y in (-0.030, 0.030)),
    *(
        Visual(f"{side}_gripper_finger_link", "box", color, center, half)
        for side, sign in (("l", 1.0), ("r", -1.0))
        for color, center, half in (
            ("gray", (-0.002, sign * 0.0095, 0.0), (0.030, 0.0055, 0.0125)),
            ("black", (0.0, sign * 0.0028, 0.0), (0.028, 0.0024, 0.0115)),
        )
    ),
)
LOOKS = (*_BASE, *_TORSO, *_HEAD, *_ARM, *_GRIPPER)


def add_visuals(bodies: dict[str, Any]) -> None:
    """Add visual geometry (geom group 2) to the bodies."""
    import mujoco

    for look in LOOKS:
        bodies[look.body].add_geom(
            type=getattr(mujoco.mjtGeom, f"mjGEOM_{look.kind.upper()}"),
            pos=look.center,
            quat=look.quaternion,
            size=look.half,
            rgba=COLORS[look.color],
            group=LOOK_GROUP,
            contype=0,
            conaffinity=0,
            mass=0.0,
        )
