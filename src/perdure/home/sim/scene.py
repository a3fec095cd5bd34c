"""A scene: apartment, robot and objects as one compiled model, its options and the addresses of its parts.

A scene is never changed: each lane steps its own copy of the model (a grasp switches a collision bit in it).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from perdure.errors import PerdureError
from perdure.home.sim.apartments import build_apartment
from perdure.home.sim.arrays import BoolArray, FloatArray, IntArray
from perdure.home.sim.objects import ROLLING, AppleShape, Placement, add_object
from perdure.home.sim.pieces import Apartment
from perdure.home.sim.robot import ROBOT, add_fetch

CONTROL_HZ = 30
"""Control steps per second, as in M3 and habitat-lab."""
PHYSICS_HZ = 120
"""Physics steps per second, as in M3 and habitat-lab."""
SERVO_HZ = 120
"""Smallest physics rate at which the robot's servos follow their targets; at 30 Hz the arm lags by 0.4 rad."""
LEVERS = (0.0, 0.0001, 0.0004, ROLLING)
"""Rolling resistances of tables and of training, see `WorldOptions.rolling`."""
MOST_ROLLING = 0.01
GraspRule = Literal["kept", "snapped"]
EARLIER: Mapping[str, Any] = {"grasp": "snapped", "base_speed": 3.0}
"""Options of the physics before they had names: of policies and logs that do not name them."""


def with_earlier_scene(noted: Any) -> Any:
    """Return the note `protocol` of logs with the options that its scene does not name."""
    if isinstance(noted, dict) and isinstance(noted.get("options"), dict):
        scene = noted["options"].get("scene", {})
        if isinstance(scene, dict):
            noted["options"]["scene"] = {**EARLIER, **scene}
    return noted


FASTEST = 3.0
"""Largest speed of the base in [m/s] that a navigation policy may ask for (M3)."""
_WORDS = {"apple": "hull-apple", "clutter": "no-clutter", "grasp": "snapped-grasp"}
"""Word of an unusual option in names."""


@dataclass(frozen=True)
class WorldOptions:
    """The variant of the physics. Each field is a flag of `perdure home run`, part of names and of stored settings."""

    rolling: float = ROLLING
    """Rolling resistance: lever arm of the weight in [m]; 0: only a drag that takes 20 % of the speed per second."""
    apple: AppleShape = "sphere"
    """Collision shape of the apple: a sphere, or a convex hull of 2,000 corners (Habitat-sim collides hulls)."""
    physics_hz: int = PHYSICS_HZ
    """Physics steps per second: 120 or more, a multiple of 30."""

    grasp: GraspRule | None = None
    """How the hand holds an object: kept as it was grasped, and it collides with the robot again after its release; or
    snapped to the gripper's axes, and it never collides with the robot again (M3). By default as the policies were
    trained."""
    base_speed: float | None = None
    """Largest speed of the base in [m/s] and [rad/s]. Fetch: about 1; M3: 3. Default as for grasp."""

    def __post_init__(self) -> None:
        """Refuse values that are not allowed, and a physics rate that is no multiple of the control rate."""
        rate = self.physics_hz
        if not isinstance(rate, int | np.integer) or rate < CONTROL_HZ or rate % CONTROL_HZ:
            raise PerdureError(f"physics_hz must be a whole multiple of {CONTROL_HZ}, not {rate!r}")
        if not isinstance(self.rolling, float | int) or not 0.0 <= self.rolling <= MOST_ROLLING:
            raise PerdureError(f"rolling must be a lever arm from 0 to {MOST_ROLLING:g} m, not {self.rolling!r}")
        for name, kinds in {"apple": get_args(AppleShape), "grasp": get_args(GraspRule)}.items():
            if getattr(self, name) not in (*kinds, None):
                raise PerdureError(f"{name} must be one of {', '.join(kinds)}, not {getattr(self, name)!r}")
        if self.base_speed is None:
            return
        if not isinstance(self.base_speed, float | int) or not 0.0 < self.base_speed <= FASTEST:
            raise PerdureError(f"base_speed must be above 0 and at most {FASTEST:g} m/s, not {self.base_speed!r}")

    @property
    def unusual(self) -> dict[str, Any]:
        """The options that change the physics and differ from their defaults, by name."""
        given = {each.name: (getattr(self, each.name), each.default) for each in fields(self)}
        free = ("visuals", "targets")
        return {name: value for name, (value, usual) in given.items() if value != usual and name not in free}

    @property
    def words(self) -> tuple[str, ...]:
        """What is unusual in words for names: ("drag", "240-hz"), ("rolling-0.4-mm",)."""
        rolling = "drag"
        if self.rolling:
            rolling = f"rolling-{1000.0 * self.rolling:g}-mm"
        numbers = {
            "physics_hz": f"{self.physics_hz}-hz",
            "rolling": rolling,
            "base_speed": f"base-{self.base_speed:g}-m-per-s",
        }
        return tuple({**_WORDS, **numbers}[name] for name in self.unusual)


@dataclass(frozen=True)
class SceneOptions(WorldOptions):
    """How a scene is built; the same options and episode give the same model."""

    grasp: GraspRule = "kept"
    base_speed: float = 1.0
    visuals: bool = False
    """Whether visual geometry is built: pictures need it, physics does not."""
    clutter: bool = True
    """Whether the scene contains clutter."""
    targets: tuple[int, ...] | None = None
    """Numbers of the targets in the scene, None for all."""


@dataclass(frozen=True, eq=False)
class Handles:
    """Handles of all drawers and doors in the room.

    A drawer's handle at joint position q is at origin + q * slide; a door's turns about its vertical hinge.
    """

    origin: FloatArray
    """At q = 0 for drawers, the hinge at the handle's height for doors. Shape (links, 3)."""
    slide: FloatArray
    """Direction of a drawer in the room, 0 for doors. Shape (links, 3)."""
    lever: FloatArray
    """From a door's hinge to its handle at q = 0 in the room's x and y, 0 for drawers. Shape (links, 2)."""
    sign: FloatArray
    """Whether a door turns to the left (1) or to the right (-1) as q grows, 0 for drawers. Shape (links,)."""

    @staticmethod
    def of(apartment: Apartment) -> Handles:
        """Return the handles of an apartment, in the order of its articulations."""
        rows = []
        for moving in apartment.articulations:
            pose = apartment.piece_of(moving.link).pose
            handle = apartment.handle_to_room(moving.link, 0.0)
            axis = pose.to_room(np.asarray(moving.axis)) - pose.to_room(np.zeros(3))
            if moving.kind == "slide":
                rows.append((handle, axis, np.zeros(2), 0.0))
            else:
                hinge = pose.to_room(np.asarray(moving.origin))
                at = np.array([hinge[0], hinge[1], handle[2]])
                rows.append((at, np.zeros(3), handle[:2] - hinge[:2], moving.axis[2]))
        origin, slide, lever, sign = (np.array([row[k] for row in rows], dtype=np.float64) for k in range(4))
        return Handles(origin.reshape(-1, 3), slide.reshape(-1, 3), lever.reshape(-1, 2), sign)

    def at(self, q: FloatArray | float) -> FloatArray:
        """Return all handles at joint positions, one for each link or one for all. Shape (links, 3)."""
        angle = self.sign * q
        cos = np.cos(angle)
        sin = np.sin(angle)
        points: FloatArray = self.origin + np.asarray(q)[..., None] * self.slide
        points[:, 0] += cos * self.lever[:, 0] - sin * self.lever[:, 1]
        points[:, 1] += sin * self.lever[:, 0] + cos * self.lever[:, 1]
        return points


REACH = 1.6
"""Radius around the base in [m]: the gripper reaches 1.1, a held object 0.2 farther, the rest is margin."""
NEARBY_LASTS = 0.15
"""Distance in [m] that the base may go until the bodies near it are determined again."""
SWING = 1.0
"""Largest displacement of a drawer or door from its compiled position in [m]."""


@dataclass(frozen=True, eq=False)
class Nearby:
    """Bounding boxes of the colliding bodies of a scene.

    MuJoCo's broad phase looks at every body at every physics step; in a furnished room that is a quarter of the step.
    While nothing is awake but the robot and what it holds, a body farther away than the robot reaches cannot be in a
    contact, so it can be left out without changing one.
    """

    contype: NDArray[np.int32]
    """As compiled. Shape (bodies,)."""
    conaffinity: NDArray[np.int32]
    """As compiled. Shape (bodies,)."""
    low: FloatArray
    """Corners of boxes around static furniture and drawers, doors, as far as they move. Shape (bodies, 2)."""
    high: FloatArray
    """Shape (bodies, 2)."""
    robot: BoolArray
    """The robot's bodies. Shape (bodies,)."""
    object_bodies: IntArray
    """Shape (objects,)."""

    @staticmethod
    def of(model: Any, object_bodies: IntArray) -> Nearby:
        """Measure a compiled `mujoco.MjModel`; the bodies `object_bodies` move freely. Shape (objects,)."""
        import mujoco

        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        robot = np.asarray(model.body_rootid == model.body(ROBOT.base).id)
        fixed = ~robot
        fixed[object_bodies] = False

        # Boxes around the geoms, along the axes of the room; a plane has no end.
        axes = data.geom_xmat.reshape(-1, 3, 3)
        planes = model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE
        middle = data.geom_xpos + (axes @ model.geom_aabb[:, :3, None])[..., 0]
        half = (np.abs(axes) @ model.geom_aabb[:, 3:, None])[..., 0]
        half[planes] = np.inf

        # A body's box encloses those of its geoms, and wherever it can move.
        low = np.full((model.nbody, 2), np.inf)
        high = np.full((model.nbody, 2), -np.inf)
        geoms = fixed[model.geom_bodyid]
        bodies = model.geom_bodyid[geoms]
        np.minimum.at(low, bodies, (middle - half)[geoms, :2])
        np.maximum.at(high, bodies, (middle + half)[geoms, :2])
        moves = fixed & (model.body_weldid != 0)
        low[moves] -= SWING
        high[moves] += SWING
        return Nearby(model.body_contype.copy(), model.body_conaffinity.copy(), low, high, robot, object_bodies)

    def around(self, base: FloatArray, objects: FloatArray) -> BoolArray:
        """Return which bodies robot or held object can touch before the base has gone `NEARBY_LASTS`. Shape (bodies,).

        Middles of the base, shape (2,), and of the objects, shape (objects, 2), in the room.
        """
        away = np.maximum(np.maximum(self.low - base, base - self.high), 0.0)
        near: BoolArray = (away * away).sum(axis=1) <= (REACH + NEARBY_LASTS) ** 2
        near |= self.robot
        if len(objects):
            apart = objects - base
            near[self.object_bodies] = (apart * apart).sum(axis=1) <= (REACH + NEARBY_LASTS) ** 2
        return near


@dataclass(frozen=True, eq=False)
class Scene:
    """A compiled model and the addresses of its parts."""

    apartment: Apartment
    opened: Mapping[str, float]
    placements: tuple[Placement, ...]
    options: SceneOptions
    model: Any
    """`mujoco.MjModel`; never changed."""

    @cached_property
    def object_qpos(self) -> IntArray:
        """Address of each object's pose in `qpos` (3 position, 4 quaternion). Shape (objects,)."""
        return self._joint_addresses([f"object_{k}/free" for k in range(len(self.placements))], "jnt_qposadr")

    @cached_property
    def object_qvel(self) -> IntArray:
        """Address of each object's velocity in `qvel` (3 linear in the room, 3 angular in its own frame)."""
        return self._joint_addresses([f"object_{k}/free" for k in range(len(self.placements))], "jnt_dofadr")

    @cached_property
    def robot_qpos(self) -> slice:
        """Where the robot's joints stand in `qpos`, in the order of `ROBOT.joints`."""
        (first,) = self._joint_addresses(ROBOT.joint_names[:1], "jnt_qposadr")
        return slice(first, first + len(ROBOT.joints))

    @cached_property
    def robot_qvel(self) -> slice:
        """Where the robot's joints stand in `qvel`."""
        (first,) = self._joint_addresses(ROBOT.joint_names[:1], "jnt_dofadr")
        return slice(first, first + len(ROBOT.joints))

    @cached_property
    def links(self) -> tuple[str, ...]:
        """Links of all drawers and doors; handles are numbered in this order."""
        return tuple(moving.link for moving in self.apartment.articulations)

    @cached_property
    def link_qpos(self) -> IntArray:
        """Address of each drawer's or door's position in `qpos`. Shape (links,)."""
        return self._joint_addresses([m.joint for m in self.apartment.articulations], "jnt_qposadr")

    @cached_property
    def link_qvel(self) -> IntArray:
        """Address of each drawer's or door's velocity in `qvel`. Shape (links,)."""
        return self._joint_addresses([m.joint for m in self.apartment.articulations], "jnt_dofadr")

    @cached_property
    def object_bodies(self) -> IntArray:
        """The bodies of the objects. Shape (objects,)."""
        return np.array([self.model.body(f"object_{k}").id for k in range(len(self.placements))], dtype=np.int64)

    @cached_property
    def object_geoms(self) -> tuple[IntArray, ...]:
        """The colliding geoms of each object."""
        model = self.model
        return tuple(
            np.nonzero((model.geom_bodyid == body) & (model.geom_contype > 0))[0] for body in self.object_bodies
        )

    @cached_property
    def geom_object(self) -> IntArray:
        """Number of the object that each geom belongs to, -1 for none. Shape (geoms,)."""
        numbers = np.full(self.model.nbody, -1, dtype=np.int64)
        numbers[self.object_bodies] = np.arange(len(self.object_bodies))
        return np.asarray(numbers[self.model.geom_bodyid])

    @cached_property
    def robot_geoms(self) -> BoolArray:
        """Which geoms belong to the robot. Shape (geoms,)."""
        return np.asarray(self.model.body_rootid[self.model.geom_bodyid] == self.model.body(ROBOT.base).id)

    @cached_property
    def arm_geoms(self) -> BoolArray:
        """Which geoms belong to the arm and its hand. Shape (geoms,)."""
        model = self.model
        inside: set[int] = set()
        first = int(model.body(ROBOT.arm[0].body).id)
        for body in range(first, model.nbody):  # a body comes after its parent
            if body == first or int(model.body_parentid[body]) in inside:
                inside.add(body)
        return np.isin(model.geom_bodyid, list(inside))

    @cached_property
    def handles(self) -> Handles:
        """Handles in the order of `links`."""
        return Handles.of(self.apartment)

    @cached_property
    def nearby(self) -> Nearby:
        """Bounding boxes for the search of nearby bodies."""
        return Nearby.of(self.model, self.object_bodies)

    def hold(self, body: str) -> int:
        """Return the equality that holds an object, `object_k`, or the handle of a link in the gripper."""
        return int(self.model.eq(f"hold/{body}").id)

    def _joint_addresses(self, names: Sequence[str], table: str) -> IntArray:
        addresses = getattr(self.model, table)
        return np.array([addresses[self.model.joint(name).id] for name in names], dtype=np.int64)


HANDLE_SOLREF = (0.02, 1.0)
"""How softly a handle is held: time constant in [s], damping ratio (MuJoCo's default)."""
HABITAT_DRAG = -math.log(1.0 - 0.2)
"""Linear and angular damping of objects in [1/s]. Habitat-sim sets 0.2 (`AbstractObjectAttributes.cpp`), which Bullet
applies as v <- v (1 - 0.2)^dt: 20 % of the speed in a second."""


def build_scene(
    apartment: Apartment,
    placements: Sequence[Placement],
    opened: Mapping[str, float] | None = None,
    options: SceneOptions | None = None,
) -> Scene:
    """Build and compile a scene, about a tenth of a second; object k is the body `object_k`.

    `opened` are joint positions of drawers and doors at the start by link name, 0 where not given.
    """
    options = options or SceneOptions()
    spec = build_apartment(apartment, visuals=options.visuals)
    _set_physics(spec, options.physics_hz)
    for number, placement in enumerate(placements):
        add_object(spec, placement, f"object_{number}", visuals=options.visuals, apple=options.apple)
    add_fetch(spec, visuals=options.visuals)
    _add_holds(spec, apartment, len(placements))
    return Scene(apartment, dict(opened or {}), tuple(placements), options, spec.compile())


def _set_physics(spec: Any, physics_hz: int) -> None:
    import mujoco

    spec.option.timestep = 1.0 / physics_hz
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    spec.option.impratio = 100.0  # with the default 1 a small rolling resistance acts as a weak drag, not as friction
    spec.option.ccd_tolerance = 1e-9  # with the default 1e-6 a can lying on its edge creeps and never sleeps
    # A diverged world must be reported, not reset silently.
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
    spec.option.enableflags |= mujoco.mjtEnableBit.mjENBL_SLEEP  # bodies at rest fall asleep


def _add_holds(spec: Any, apartment: Apartment, objects: int) -> None:
    """One weld per object and one point-to-point constraint per handle, all switched off."""
    import mujoco

    def hold(body: str, kind: Any, **settings: Any) -> Any:
        ends = {"objtype": mujoco.mjtObj.mjOBJ_BODY, "name1": ROBOT.gripper, "name2": body}
        return spec.add_equality(name=f"hold/{body}", type=kind, active=False, **ends, **settings)

    for number in range(objects):
        weld = hold(f"object_{number}", mujoco.mjtEq.mjEQ_WELD)
        data = np.zeros(len(weld.data))
        data[3:6] = spec.site(ROBOT.gripper_site).pos
        data[6:10] = (1.0, 0.0, 0.0, 0.0)
        data[10] = 1.0  # as stiff against turns as against displacements
        weld.data = data
    for moving in apartment.articulations:
        hold(moving.link, mujoco.mjtEq.mjEQ_CONNECT, solref=HANDLE_SOLREF)
