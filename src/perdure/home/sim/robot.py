"""The Fetch robot: `data/fetch.xml`, and what the package needs of it without a simulator.

The file says where its numbers come from. Its section `custom` says what the benchmark uses each part for: which joints
form the arm, which body is the gripper, where the arm rests. `ROBOT` is all of it as one record.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

import numpy as np

from perdure.home.sim.arrays import FloatArray, Vec3
from perdure.home.sim.geoms import COLLIDES_AND_SEEN, ONLY_COLLIDES, ONLY_SEEN

_FILE = Path(__file__).parents[1] / "data" / "fetch.xml"


class Joint(NamedTuple):
    """A joint and where it is."""

    name: str
    body: str
    """The body that it moves."""
    axis: Vec3
    origin: Vec3
    """Of its body in the parent's frame in [m]."""
    low: float
    """Limits in [rad] or [m], infinite for a continuous joint."""
    high: float


class ActionColumns(NamedTuple):
    """Columns of an action, whose numbers are from -1 to 1."""

    forward: int
    """Forward speed of the base."""
    turn: int
    """Turning speed of the base, to the left."""
    arm: slice
    """Change of the servo target of each joint of the arm."""
    grip: int
    """Above 0 the gripper grasps, below 0 it releases."""
    stop: int
    """Whether the robot says that it has arrived."""


@dataclass(frozen=True, eq=False)
class Robot:
    """What the benchmark knows of a robot: a base that drives on the floor, a torso, an arm, a gripper."""

    joints: tuple[Joint, ...]
    """All joints, in the order of the model and of the actuators: base (x and y of the room, heading), torso, arm from
    the shoulder to the wrist, fingers. All actuators but those of the base are named after their joints."""
    base: str
    """The body of the base, the root of the robot."""
    base_radius: float
    """Radius of the base, a cylinder, in [m]."""
    torso: Joint
    arm: tuple[Joint, ...]
    fingers: tuple[Joint, ...]
    gripper: str
    """The body of the gripper, fixed to the last link of the arm."""
    gripper_site: str
    """The site of the gripper point: what is near or far, and what a held object hangs on (M3)."""
    gripper_point: Vec3
    """The gripper point in the frame of the last link of the arm in [m]."""
    cameras: tuple[str, ...]
    head_camera: str
    """The camera that takes depth images."""
    torso_height: float
    """Where the benchmark keeps the torso in [m] (M3, habitat-lab: the torso's joint is pinned in each step)."""
    rest_arm: FloatArray
    """Joint angles of the arm at rest in [rad]. Shape (joints of the arm,)."""
    other_arms: FloatArray
    """Other poses of the arm from which inverse kinematics starts. Shape (poses, joints of the arm)."""
    rest_position: FloatArray
    """Where the gripper point rests in the base frame in [m] (M3, habitat-lab). Shape (3,)."""
    finger_opening: float
    """Position of each finger of M3's open gripper in [m]."""

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Return the names of all joints."""
        return tuple(joint.name for joint in self.joints)

    @property
    def arm_names(self) -> tuple[str, ...]:
        """Return the names of the arm's joints."""
        return tuple(joint.name for joint in self.arm)

    @cached_property
    def torso_column(self) -> int:
        """The torso among `joints`."""
        return self.joints.index(self.torso)

    @cached_property
    def arm_columns(self) -> slice:
        """The arm among `joints`."""
        first = self.joints.index(self.arm[0])
        return slice(first, first + len(self.arm))

    @cached_property
    def finger_columns(self) -> slice:
        """The fingers among `joints`."""
        first = self.joints.index(self.fingers[0])
        return slice(first, first + len(self.fingers))

    @cached_property
    def arm_low(self) -> FloatArray:
        """Lower limits of the arm in [rad], -inf for a joint that turns without end. Shape (joints of the arm,)."""
        return _constant([joint.low for joint in self.arm])

    @cached_property
    def arm_high(self) -> FloatArray:
        """Upper limits of the arm in [rad], inf for a joint that turns without end. Shape (joints of the arm,)."""
        return _constant([joint.high for joint in self.arm])

    @cached_property
    def continuous(self) -> list[int]:
        """The joints of the arm that turn without end."""
        return [number for number, joint in enumerate(self.arm) if math.isinf(joint.low)]

    @cached_property
    def action(self) -> ActionColumns:
        """The columns of an action."""
        arm = slice(2, 2 + len(self.arm))
        return ActionColumns(forward=0, turn=1, arm=arm, grip=arm.stop, stop=arm.stop + 1)

    @property
    def action_size(self) -> int:
        """Return how many numbers an action has."""
        return self.action.stop + 1


def _constant(values: list[float]) -> FloatArray:
    """Return numbers as an array that cannot be written to."""
    array = np.array(values, dtype=np.float64)
    array.flags.writeable = False
    return array


def _vector(element: Any, name: str) -> Vec3:
    x, y, z = map(float, element.get(name, "0 0 0").split())
    return x, y, z


def _joint(body: Any, joint: Any) -> Joint:
    low, high = map(float, joint.get("range", "-inf inf").split())
    return Joint(joint.attrib["name"], body.attrib["name"], _vector(joint, "axis"), _vector(body, "pos"), low, high)


def read_robot(path: Path) -> Robot:
    """Return the robot of a model file whose section `custom` says what its parts are for."""
    root = ElementTree.parse(path).getroot()
    texts = {each.attrib["name"]: each.attrib["data"] for each in root.iterfind("custom/text")}
    numbers = {
        each.attrib["name"]: [float(number) for number in each.attrib["data"].split()]
        for each in root.iterfind("custom/numeric")
    }
    bodies: dict[str, Any] = {body.attrib["name"]: body for body in root.iter("body")}
    joints = {}
    for body in bodies.values():
        for element in body.findall("joint"):
            joint = _joint(body, element)
            joints[joint.name] = joint

    geoms = {geom.attrib["name"]: geom for geom in root.iter("geom") if "name" in geom.attrib}
    base_radius, _ = map(float, geoms[texts["base_shape"]].attrib["size"].split())
    site: Any = bodies[texts["gripper"]].find("site")
    # The gripper is fixed to the last link of the arm, so its point is fixed there, too.
    gripper_origin = np.array(_vector(bodies[texts["gripper"]], "pos"))
    x, y, z = (gripper_origin + np.array(_vector(site, "pos"))).tolist()
    return Robot(
        joints=tuple(joints.values()),
        base=texts["base"],
        base_radius=base_radius,
        torso=joints[texts["torso"]],
        arm=tuple(joints[name] for name in texts["arm"].split()),
        fingers=tuple(joints[name] for name in texts["fingers"].split()),
        gripper=texts["gripper"],
        gripper_site=site.attrib["name"],
        gripper_point=(x, y, z),
        cameras=tuple(camera.attrib["name"] for camera in root.iter("camera")),
        head_camera=texts["head_camera"],
        torso_height=numbers["torso_height"][0],
        rest_arm=_constant(numbers["rest_arm"]),
        other_arms=_constant(numbers["other_arms"]).reshape(-1, len(texts["arm"].split())),
        rest_position=_constant(numbers["rest_position"]),
        finger_opening=numbers["finger_opening"][0],
    )


ROBOT = read_robot(_FILE)


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
    """Return the model file as a specification, without the notes that only `read_robot` needs."""
    import mujoco

    spec = mujoco.MjSpec.from_file(str(_FILE))
    for note in (*spec.texts, *spec.numerics):
        spec.delete(note)
    if not visuals:
        for geom in spec.geoms:
            if geom.group == ONLY_SEEN:
                spec.delete(geom)
            elif geom.group == ONLY_COLLIDES:
                geom.group = COLLIDES_AND_SEEN
    return spec
