"""The Fetch robot: `data/fetch.xml`, and what the package needs of it without a simulator.

The file says where its numbers come from. Joints and actuators have the same order; all but those of the base have the
same names.
"""

from __future__ import annotations

import math
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

from perdure.home.sim.arrays import Vec3
from perdure.home.sim.geoms import COLLIDES_AND_SEEN, ONLY_COLLIDES, ONLY_SEEN

_FILE = Path(__file__).parents[1] / "data" / "fetch.xml"
_FETCH = ElementTree.parse(_FILE).getroot()


class Joint(NamedTuple):
    """A joint and where it is."""

    name: str
    axis: Vec3
    origin: Vec3
    """Of its body in the parent's frame in [m]."""
    low: float
    """Limits in [rad] or [m], infinite for a continuous joint."""
    high: float


def _vector(element: Any, name: str) -> Vec3:
    x, y, z = map(float, element.get(name, "0 0 0").split())
    return x, y, z


def _joint(body: Any, joint: Any) -> Joint:
    low, high = map(float, joint.get("range", "-inf inf").split())
    return Joint(joint.attrib["name"], _vector(joint, "axis"), _vector(body, "pos"), low, high)


_JOINTS = [_joint(body, joint) for body in _FETCH.iter("body") for joint in body.findall("joint")]
TORSO, ARM = _JOINTS[3], _JOINTS[4:11]
JOINTS = tuple(joint.name for joint in _JOINTS)
"""All joints, in the order of the model and of the actuators: the base (x and y of the room, heading), the torso, the
seven of the arm from the shoulder to the wrist, the two fingers."""
ARM_JOINTS = JOINTS[4:11]
ARM_LOW, ARM_HIGH = tuple(joint.low for joint in ARM), tuple(joint.high for joint in ARM)
"""Limits of the arm in [rad] (URDF); the three rolls turn without end."""
ROLLS = [number for number, joint in enumerate(ARM) if math.isinf(joint.low)]
"""Joints of the arm that turn without end."""
_GRIPPER: Any = _FETCH.find(".//body[@name='gripper_link']")
GRIPPER_ORIGIN = _vector(_GRIPPER, "pos")
"""`gripper_link` in the frame of `wrist_roll_link`, to which it is fixed."""
GRIPPER_POINT = _vector(_GRIPPER.find("site"), "pos")
"""M3's gripper point in the frame of `gripper_link` in [m]: what is near or far, and what a held object hangs on."""
BASE_RADIUS = 0.285
"""Of the base, a cylinder, in [m]."""
TORSO_HEIGHT = 0.15
"""Where the benchmark keeps the torso in [m] (M3, habitat-lab: `torso_lift_joint` pinned each step)."""
OPEN = 0.04
"""Position of each finger of M3's open gripper in [m]."""
REST_POSITION = (0.5, 0.0, 1.0)
"""Where the gripper rests in the base frame in [m] (M3 and habitat-lab: resting position)."""
# M3's initial pose (-.268, -1.133, .367, 1.081, .06, 2.002, .067) brings `gripper_link` there to the millimeter and the
# gripper point 1 cm above; from it inverse kinematics found this one, with the same direction of the fingers.
REST_ARM = (-0.270325, -1.141013, 0.369315, 1.122742, 0.061235, 1.968084, 0.065927)
"""Joint angles of the arm at rest in [rad]."""


def add_fetch(spec: Any, *, visuals: bool = True) -> None:
    """Add the robot to an `mujoco.MjSpec`, at the room's origin with all joints at 0.

    Names are those in the file; those of geoms begin with `robot/`. Without `visuals` there is no visual geometry, and
    the colliding shapes are visible.
    """
    robot = _parsed(visuals).copy()
    spec.attach(robot, prefix="robot/", frame=spec.worldbody.add_frame())  # an empty prefix makes MuJoCo warn
    for actuator in robot.actuators:
        actuator.target = actuator.target.removeprefix("robot/")
    for elements in (robot.bodies[1:], robot.joints, robot.sites, robot.cameras, robot.actuators):
        for element in elements:
            element.name = element.name.removeprefix("robot/")


@cache
def _parsed(visuals: bool) -> Any:
    import mujoco

    spec = mujoco.MjSpec.from_file(str(_FILE))
    if not visuals:
        for geom in spec.geoms:
            if geom.group == ONLY_SEEN:
                spec.delete(geom)
            elif geom.group == ONLY_COLLIDES:
                geom.group = COLLIDES_AND_SEEN
    return spec
