"""From an episode to a compiled MuJoCo model: apartment, robot, objects, and the constraints of the magic grasp.

A scene is pristine: a lane steps its own copy of the model (a grasp switches a collision bit in it).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, get_args

import numpy as np

from perdure.home.errors import HomeError
from perdure.home.sim.apartments import Apartment, build_apartment
from perdure.home.sim.arrays import BoolArray, FloatArray, IntArray
from perdure.home.sim.objects import AppleShape, Placement, YcbObjects
from perdure.home.sim.robot import add_fetch
from perdure.home.sim.robot.data import JOINTS
from perdure.home.sim.world.base_bumper import add_base_bumper
from perdure.home.sim.world.handles import Handles
from perdure.home.sim.world.nearby import Nearby

CONTROL_HZ = 30
"""Control steps per second, as in M3 and habitat-lab."""
PHYSICS_HZ = 120
"""Physics steps per second, as in M3 and habitat-lab; `docs/home/world.md` shows what 60, 240 and 480 change."""
SERVO_HZ = 120
"""Smallest physics rate at which the robot's servos follow their targets; at 30 Hz the arm lags by 0.4 rad."""
HANDLE_SOLREF = (0.02, 1.0)
"""How softly a handle is held: time constant in [s], damping ratio (MuJoCo's default)."""
HABITAT_DRAG = -math.log(1.0 - 0.2)
"""Linear and angular damping of objects in [1/s]. Habitat-sim sets 0.2 (`AbstractObjectAttributes.cpp`), which Bullet
applies as v <- v (1 - 0.2)^dt: 20 % of the speed in a second."""
Rolling = Literal["friction", "drag"]
ReleaseVelocity = Literal["kept", "base-removed", "zero"]
"""Velocity of an object as the hand opens: unchanged, without the part that the moving base gives it, or none."""


@dataclass(frozen=True)
class SceneOptions:
    """How a scene is built; the same options and episode give the same model."""

    physics_hz: int = PHYSICS_HZ
    """A multiple of 30; `SERVO_HZ` or more where the robot moves."""
    visuals: bool = False
    """Whether visual geometry is built: pictures need it, physics does not."""
    clutter: bool = True
    """Whether the scene contains clutter."""
    targets: tuple[int, ...] | None = None
    """Numbers of the targets in the scene, None for all."""
    rolling: Rolling = "friction"
    """What stops an object that rolls: rolling friction (`docs/home/objects.md`), or a slow drag alone."""
    apple: AppleShape = "sphere"
    release_velocity: ReleaseVelocity = "kept"
    sleep: bool = True
    """Whether bodies at rest fall asleep (MuJoCo's sleeping islands)."""

    def __post_init__(self) -> None:
        """A physics rate that is no multiple of the control rate raises HomeError."""
        rate = self.physics_hz
        if not isinstance(rate, int | np.integer) or rate < CONTROL_HZ or rate % CONTROL_HZ:
            raise HomeError(f"physics_hz must be a whole multiple of {CONTROL_HZ}, not {rate!r}")
        for name, kind in (("rolling", Rolling), ("apple", AppleShape), ("release_velocity", ReleaseVelocity)):
            if (value := getattr(self, name)) not in get_args(kind):
                raise HomeError(f"{name} must be one of {', '.join(get_args(kind))}, not {value!r}")

    @property
    def substeps(self) -> int:
        """Physics steps in one control step."""
        return self.physics_hz // CONTROL_HZ


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
    def middles(self) -> IntArray:
        """Where the objects' middles stand in `qpos`. Shape (objects, 3)."""
        return self.object_qpos[:, None] + np.arange(3)

    @cached_property
    def poses(self) -> IntArray:
        """Where the objects' poses stand in `qpos`. Shape (objects, 7)."""
        return self.object_qpos[:, None] + np.arange(7)

    @cached_property
    def velocities(self) -> IntArray:
        """Where the objects' linear velocities stand in `qvel`. Shape (objects, 3)."""
        return self.object_qvel[:, None] + np.arange(3)

    @cached_property
    def object_qvel(self) -> IntArray:
        """Address of each object's velocity in `qvel` (3 linear in the room, 3 angular in its own frame)."""
        return self._joint_addresses([f"object_{k}/free" for k in range(len(self.placements))], "jnt_dofadr")

    @cached_property
    def robot_qpos(self) -> slice:
        """Where the robot's joints stand in `qpos`, in the order of `perdure.home.sim.robot.JOINTS`."""
        first = int(self._joint_addresses([JOINTS[0]], "jnt_qposadr")[0])
        return slice(first, first + len(JOINTS))

    @cached_property
    def robot_qvel(self) -> slice:
        """Where the robot's joints stand in `qvel`."""
        first = int(self._joint_addresses([JOINTS[0]], "jnt_dofadr")[0])
        return slice(first, first + len(JOINTS))

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
        bodies = [self.model.body(f"object_{k}").id for k in range(len(self.placements))]
        return np.array(bodies, dtype=np.int64)

    @cached_property
    def object_geoms(self) -> tuple[IntArray, ...]:
        """The colliding geoms of each object."""
        model = self.model
        return tuple(
            np.nonzero((model.geom_bodyid == body) & (model.geom_contype > 0))[0] for body in self.object_bodies
        )

    @cached_property
    def robot_geoms(self) -> BoolArray:
        """Which geoms belong to the robot. Shape (geoms,)."""
        root = int(self.model.body("robot").id)
        return np.asarray(self.model.body_rootid[self.model.geom_bodyid] == root)

    @cached_property
    def loose_geoms(self) -> BoolArray:
        """Which geoms belong to objects. Shape (geoms,)."""
        return np.isin(self.model.geom_bodyid, self.object_bodies)

    @cached_property
    def arm_geoms(self) -> BoolArray:
        """Which geoms belong to the arm and its hand. Shape (geoms,)."""
        model, inside = self.model, set()
        first = int(model.body("shoulder_pan_link").id)
        for body in range(first, model.nbody):  # a body comes after its parent
            if body == first or int(model.body_parentid[body]) in inside:
                inside.add(body)
        return np.isin(model.geom_bodyid, list(inside))

    @cached_property
    def object_reach(self) -> FloatArray:
        """Largest side of each object's bounding box in [m]. Shape (objects,)."""
        return np.array([max(YcbObjects().kind(p.kind).size) for p in self.placements])

    @cached_property
    def gripper_offset(self) -> FloatArray:
        """The gripper point in the frame of body `gripper_link`. Shape (3,)."""
        return np.array(self.model.site("gripper").pos)

    @cached_property
    def handles(self) -> Handles:
        """Handles in the order of `links`."""
        return Handles.of(self.apartment)

    @cached_property
    def nearby(self) -> Nearby:
        """Bounding boxes for the search of nearby bodies."""
        return Nearby.of(self.model, self.object_bodies)

    def weld(self, number: int) -> int:
        """Return the equality that holds object `number` in the gripper."""
        return int(self.model.eq(f"hold/object_{number}").id)

    def grip(self, link: int) -> int:
        """Return the equality that holds the handle of link `link`."""
        return int(self.model.eq(f"hold/{self.links[link]}").id)

    def _joint_addresses(self, names: Sequence[str], table: str) -> IntArray:
        addresses = getattr(self.model, table)
        return np.array([addresses[self.model.joint(name).id] for name in names], dtype=np.int64)


def build_scene(
    apartment: Apartment,
    placements: Sequence[Placement],
    opened: Mapping[str, float] | None = None,
    options: SceneOptions | None = None,
) -> Scene:
    """Build and compile a scene, about a tenth of a second; object k is the body `object_k`.

    `opened` are joint positions of drawers and doors at the start by link name, 0 where not given.
    """
    import mujoco

    options = options or SceneOptions()
    spec = mujoco.MjSpec()
    _set_physics(spec, options)
    build_apartment(apartment, spec, visuals=options.visuals)
    objects = YcbObjects(visuals=options.visuals, apple=options.apple)
    for number, placement in enumerate(placements):
        objects.add(spec, placement.kind, f"object_{number}", placement.position, placement.quaternion)
    add_fetch(spec, visuals=options.visuals)
    add_base_bumper(spec, apartment)
    _add_holds(spec, apartment, len(placements))
    scene = Scene(apartment, dict(opened or {}), tuple(placements), options, spec.compile())
    if options.rolling == "drag":
        _let_roll(scene)
    return scene


def _set_physics(spec: Any, options: SceneOptions) -> None:
    import mujoco

    spec.option.timestep = 1.0 / options.physics_hz
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    spec.option.ccd_tolerance = 1e-9  # with the default 1e-6 a can lying on its edge creeps and never sleeps
    # A diverged world must be reported, not reset silently.
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
    if options.sleep:
        spec.option.enableflags |= mujoco.mjtEnableBit.mjENBL_SLEEP


def _let_roll(scene: Scene) -> None:
    """Let objects roll and spin without friction; they lose 20 % of their speed and spin in a second."""
    model = scene.model
    for number, geoms in enumerate(scene.object_geoms):
        model.geom_condim[geoms] = 3
        body, dof = model.body(f"object_{number}").id, int(scene.object_qvel[number])
        model.dof_damping[dof : dof + 3] = HABITAT_DRAG * model.body_mass[body]
        model.dof_damping[dof + 3 : dof + 6] = HABITAT_DRAG * model.body_inertia[body]


def _add_holds(spec: Any, apartment: Apartment, objects: int) -> None:
    """One weld per object and one point-to-point constraint per handle, all switched off."""
    import mujoco

    site = spec.site("gripper")
    offset = np.array(site.pos)
    for number in range(objects):
        equality = spec.add_equality(
            name=f"hold/object_{number}",
            type=mujoco.mjtEq.mjEQ_WELD,
            objtype=mujoco.mjtObj.mjOBJ_BODY,
            name1="gripper_link",
            name2=f"object_{number}",
            active=False,
        )
        data = np.zeros(len(equality.data))
        data[3:6], data[6:10], data[10] = offset, (1.0, 0.0, 0.0, 0.0), 1.0
        equality.data = data
    for moving in apartment.articulations:
        spec.add_equality(
            name=f"hold/{moving.link}",
            type=mujoco.mjtEq.mjEQ_CONNECT,
            objtype=mujoco.mjtObj.mjOBJ_BODY,
            name1="gripper_link",
            name2=moving.link,
            active=False,
            solref=HANDLE_SOLREF,
        )
