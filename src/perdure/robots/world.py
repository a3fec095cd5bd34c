"""`perdure/VelocityCommand-v0`: a robot on flat ground tracks a velocity command; MuJoCo, built from a contract.

The action is an offset of the joint targets from the default pose, times `action_scale`. Joint controllers are MuJoCo's
position actuators, so that torques follow every physics step without Python. An episode ends with a fall: the base
tilts beyond a limit, or the trunk touches the floor. It has no time limit.

The reward of a step is the product of mjlab's tracking terms of the planar velocity and of the yaw rate, 1 at most. (Of
their sum, a robot that only stands gets as much as one that walks: its yaw rate is perfect.) A fall takes back what the
last second earned: falling forward is no walking. `info` has what the reward does not see, in the frame of the world:
`perdure.report.schema.MEASURES`.
"""

from __future__ import annotations

import copy
import math
import os
from collections import deque
from collections.abc import Callable, Sequence
from functools import lru_cache
from hashlib import file_digest, sha256
from pathlib import Path
from typing import Any

import gymnasium
import mujoco
import numpy as np
from gymnasium.envs.mujoco import MujocoEnv
from msgspec.structs import fields

from perdure.errors import PerdureError
from perdure.robots.contract import Command, Contract, FloatArray, Term
from perdure.robots.harness import HeadingCorrection, JointTargets, held_joints
from perdure.robots.readers import read_contract
from perdure.robots.terms import ObservationTerm, RobotState, imu_place

LINEAR_VARIANCE = 0.25
"""Of the tracking reward of the planar velocity, as in mjlab [m^2/s^2]."""
ANGULAR_VARIANCE = 0.5
"""Of the tracking reward of the yaw rate, as in mjlab [rad^2/s^2]."""
START_GAP = 0.01
"""Air under the lowest point of a robot in its start state [m]."""
JOINT_NOISE = 0.05
"""Largest difference of a joint in a start state from the default pose [rad]."""
FALLBACK_RANGE = math.pi  # half the range of a joint without limits [rad]
TRUNK = 1  # kinds of geoms
FLOOR = 2
MINUTE = 60.0
DEFAULTS = {each.name: each.default for each in fields(Contract)}
JOINT_FIELDS = {"armature": "armature", "joint_damping": "damping", "friction_loss": "frictionloss"}


def compiled(contract: Contract, visual: bool) -> Any:
    """Return MuJoCo's model of a robot on a floor, with a controller for each joint in the order of the contract.

    It is compiled once, and again when one of its files has changed.

    Raises:
        PerdureError: If MuJoCo cannot read it, or it does not fit the contract.
    """
    content = _content(contract.model)
    if not content:
        return _compiled.__wrapped__(contract, visual, content)
    return _compiled(contract, visual, content)


def _content(model: str) -> tuple[bytes, ...]:
    """Return the SHA-256 of an MJCF file and of each file that it names; () where they cannot be read."""
    try:
        digests = []
        for file in sorted(mujoco.mju_getXMLDependencies(model)):
            state = os.stat(file)
            digests.append(_file_content(file, state.st_ino, state.st_size, state.st_ctime_ns))
        return tuple(digests)
    except (mujoco.FatalError, OSError):  # compiling the model says what is wrong
        return ()


@lru_cache(1000)
def _file_content(file: str, inode: int, size: int, changed: int) -> bytes:
    """Return the SHA-256 of a file. Each environment asks for it, so it is read again only after a change."""
    with open(file, "rb") as opened:
        return file_digest(opened, "sha256").digest()


@lru_cache(4)
def _compiled(contract: Contract, visual: bool, content: tuple[bytes, ...]) -> Any:
    """Return the model; `content` is only part of the key of the cache."""
    try:
        spec = mujoco.MjSpec.from_file(contract.model)
        # The contract's controllers replace the model's own actuators, whose torque limits still hold.
        limits = {each.target: _torque_limit(each) for each in spec.actuators}
        unset = mujoco.MjSpec().default  # what is added takes nothing from the model's own defaults
        for each in (*spec.keys, *spec.sensors, *spec.actuators):
            spec.delete(each)
        if not any(geom.type == mujoco.mjtGeom.mjGEOM_PLANE for geom in spec.worldbody.geoms):
            floor = spec.worldbody.add_geom(unset, name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 0.05])
            if visual:
                _decorate(spec, floor)
        for index, name in enumerate(contract.joints):
            _add_controller(spec, contract, index, limits.get(name, math.inf), unset)
        kinds = (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)
        joints = [each.name for each in spec.joints if each.type in kinds]
        for name, (_, *gains) in held_joints(contract, joints).items():
            _add_servo(spec, name, gains, _joint_limit(spec.joint(name), limits.get(name, math.inf)), unset)
        missing = [name for name in contract.trunk if spec.body(name) is None]
        if missing:
            raise PerdureError(f"trunk: {contract.model} has no body {', '.join(missing)}")
        spec.option.timestep = contract.time_step
        spec.compiler.discardvisual = not visual
        spec.visual.global_.offwidth = 1920
        spec.visual.global_.offheight = 1080
        model = spec.compile()
    except PerdureError:
        raise
    except (ValueError, OSError) as error:
        raise PerdureError(f"{contract.model}: {' '.join(str(error).split())[:300]}") from None
    if model.njnt == 0 or model.jnt_type[0] != mujoco.mjtJoint.mjJNT_FREE or model.jnt_bodyid[0] != 1:
        raise PerdureError(f"{contract.model}: the first body must be the robot's base, with a free joint")
    return model


def sources(task: str) -> dict[str, str]:
    """Return the SHA-256 of what results depend on: the contract, and the compiled model with its meshes."""
    contract = read_contract(task)
    model = compiled(contract, False)
    data = np.empty(mujoco.mj_sizeModel(model), np.uint8)
    mujoco.mj_saveModel(model, None, data)
    # Only what is not by default: a field that a later version adds then changes no digest.
    stated = [(each.name, getattr(contract, each.name)) for each in fields(contract) if each.name != "model"]
    chosen = [(name, value) for name, value in stated if value != DEFAULTS[name]]
    return {"robot": sha256(repr(chosen).encode() + data.tobytes()).hexdigest()}


def _torque_limit(actuator: Any) -> float:
    """Return the largest torque of an actuator of the MJCF at its joint; inf: it has no limit."""
    gear = abs(float(actuator.gear[0]))
    if actuator.forcerange[0] < actuator.forcerange[1]:
        return float(actuator.forcerange[1]) * gear
    motor = actuator.biastype == mujoco.mjtBias.mjBIAS_NONE and actuator.ctrlrange[0] < actuator.ctrlrange[1]
    if not motor:
        return math.inf
    return float(actuator.ctrlrange[1] * actuator.gainprm[0]) * gear


def _decorate(spec: Any, floor: Any) -> None:
    """Give a floor tiles, and the world a sky and more light, for pictures."""
    for name, kind, pattern in (
        ("perdure/tiles", mujoco.mjtTexture.mjTEXTURE_2D, mujoco.mjtBuiltin.mjBUILTIN_CHECKER),
        ("perdure/sky", mujoco.mjtTexture.mjTEXTURE_SKYBOX, mujoco.mjtBuiltin.mjBUILTIN_GRADIENT),
    ):
        made = spec.add_texture(name=name, type=kind, builtin=pattern, width=64, height=64)
        made.rgb1 = [0.65, 0.72, 0.8]
        made.rgb2 = [0.8, 0.84, 0.88]
    floor.material = "perdure/tiles"
    spec.add_material(name=floor.material).textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = floor.material
    spec.visual.headlight.ambient = spec.visual.headlight.diffuse = [0.45] * 3


def _add_controller(spec: Any, contract: Contract, index: int, limit: float, unset: Any) -> None:
    """Add a joint's controller to the model, and change the joint where the contract says so."""
    name = contract.joints[index]
    joint = spec.joint(name)
    if joint is None:
        known = ", ".join(each.name for each in spec.joints if each.name)
        raise PerdureError(f"{contract.model} has no joint {name!r}; it has {known}")
    for field, attribute in JOINT_FIELDS.items():
        if getattr(contract, field) is not None:
            number: Any = float(contract.values(field)[index])
            if np.ndim(getattr(joint, attribute)) > 0:  # since MuJoCo 3.7 a polynomial
                number = [number, 0.0, 0.0]
            setattr(joint, attribute, number)
    limit = _joint_limit(joint, limit)
    if contract.effort_limit is not None:
        limit = float(contract.values("effort_limit")[index])
    gains = [float(contract.values("stiffness")[index]), float(contract.values("damping")[index])]
    _add_servo(spec, name, gains, limit, unset)


def _joint_limit(joint: Any, limit: float) -> float:
    """Return the largest torque at a joint of the MJCF: its own, or that of its actuator."""
    if joint.actfrcrange[0] < joint.actfrcrange[1]:
        return min(limit, float(joint.actfrcrange[1]))
    return limit


def _add_servo(spec: Any, name: str, gains: Sequence[float], limit: float, unset: Any) -> None:
    """Add a position actuator with stiffness, damping and a largest torque."""
    joint = spec.joint(name)
    joint.actfrclimited = mujoco.mjtLimited.mjLIMITED_FALSE  # it would cut a higher or disturbed limit
    made = spec.add_actuator(unset, name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
    made.gaintype = mujoco.mjtGain.mjGAIN_FIXED
    made.biastype = mujoco.mjtBias.mjBIAS_AFFINE
    stiffness, damping = gains
    made.gainprm[0] = stiffness
    made.biasprm[1] = -stiffness
    made.biasprm[2] = -damping
    if limit < math.inf:
        made.forcelimited = True
        made.forcerange = [-limit, limit]


def action_range(model: Any, contract: Contract) -> tuple[FloatArray, FloatArray]:
    """Return the lowest and highest action: beyond them a joint's torque is at its limit wherever the joint is.

    Half of this range is the unit of disturbed actions.
    """
    count = len(contract.joints)  # after them come joints that the harness holds
    joints = model.actuator_trnid[:count, 0]
    stiffness = np.maximum(contract.values("stiffness"), 1e-9)
    limited = model.jnt_limited[joints].astype(bool)[:, None]
    ends = np.where(limited, model.jnt_range[joints], [-FALLBACK_RANGE, FALLBACK_RANGE]).T
    limited = model.actuator_forcelimited[:count].astype(bool)
    reach = np.where(limited, model.actuator_forcerange[:count, 1] / stiffness, FALLBACK_RANGE)
    ends = (ends + np.outer([-1.0, 1.0], reach) - contract.values("default_pose")) / contract.values("action_scale")
    low, high = np.clip(np.sort(ends, axis=0), -contract.action_clip, contract.action_clip)
    return np.minimum(low, 0.0), np.maximum(high, 0.0)


# What a robot is told, what it sees, and measures of its walk


class Schedule:
    """The velocity command of a contract at each time of an episode; call `begin` before one."""

    def __init__(self, contract: Contract) -> None:
        self._contract = contract
        self.command = contract.command

    def begin(self, rng: np.random.Generator) -> None:
        """Begin an episode."""
        self._rng = rng
        self._until = math.inf  # when the next command is due [s]
        if self._contract.script or self._contract.random:
            self._until = 0.0

    def at(self, seconds: float) -> Command:
        """Return the command at a time, which must not go back; it is also kept as `command`."""
        if seconds < self._until:
            return self.command
        random = self._contract.random
        if random is not None:
            drawn = self._rng.uniform(random.low, random.high) * (self._rng.random() >= random.standing)
            self.command = tuple(drawn.tolist())
            self._until = seconds + self._rng.uniform(*random.seconds)
        else:
            script = self._contract.script
            period = self._contract.repeat
            within = math.fmod(seconds + 1e-9, period)
            now = max(row for row, each in enumerate(script) if each[0] <= within)
            ends = min([period, *(each[0] for each in script[now + 1 :])])
            self.command = script[now][1:]
            self._until = seconds + ends - within
        return self.command


def _value(term: Term, kinds: dict[str, type[ObservationTerm]]) -> Callable[[RobotState], Any]:
    """Return what computes the values of a term."""
    if term.value is None:
        return kinds[term.name]().value
    constants = term.constants
    return lambda robot: constants


class Observer:
    """Observations of a contract: values of its terms, scaled and clipped, and their history."""

    def __init__(self, contract: Contract) -> None:
        terms = contract.terms
        kinds = ObservationTerm.kinds()
        widths = [contract.size(term) for term in terms]

        # One step: where the values of each term go, and their scales and limits.
        self._values: list[tuple[Callable[[RobotState], Any], slice]] = []
        columns: list[str] = []
        for term, width in zip(terms, widths, strict=True):
            begin = len(columns)
            self._values.append((_value(term, kinds), slice(begin, begin + width)))
            columns += [f"{term.name}[{k}]" for k in range(width)]
        self._raw = np.zeros(len(columns))
        self._scale = np.concatenate([np.broadcast_to(t.scale, w) for t, w in zip(terms, widths, strict=True)])
        clips = np.where(self._scale[:, None] == 0.0, 0.0, np.repeat([term.clip for term in terms], widths, axis=0))
        ranges = np.sort(clips * self._scale[:, None])
        self._low, self._high = ranges.clip(-contract.observation_clip, contract.observation_clip).T

        # The history: rows are the last steps, the newest one last. An observation takes from it in `_order`.
        longest = max(term.history for term in terms)
        self._past = np.zeros((longest, len(columns)))
        self._empty = True
        places = np.arange(self._past.size).reshape(longest, -1)
        parts = []
        for term, (_, mine) in zip(terms, self._values, strict=True):
            part = places[longest - term.history :, mine]
            if contract.history_order == "newest first":
                part = part[::-1]
            if contract.history_layout == "by term":
                part = part.ravel()
            parts.append(part)
        self._order = np.hstack(parts).ravel()
        self.names = [columns[place % len(columns)] for place in self._order]
        """Of each component of an observation."""

    def begin(self) -> None:
        """Begin an episode: its first step fills the history."""
        self._empty = True

    def read(self, robot: RobotState) -> FloatArray:
        """Return the observation of a robot as it is now."""
        for value, places in self._values:
            self._raw[places] = value(robot)
        step: FloatArray = np.minimum(np.maximum(self._raw * self._scale, self._low), self._high)
        if len(self._past) == 1:
            return step
        if self._empty:
            self._past[:] = step
        else:
            self._past[:-1] = self._past[1:]
            self._past[-1] = step
        self._empty = False
        return np.array(self._past.take(self._order))


class Walk:
    """Measures of a walk from the origin along x; a commanded path begins anew, where the robot is, every minute."""

    def __init__(self) -> None:
        # Sums since the start: time [s], velocity error x time [m], work [J], path [m].
        self._seconds = self._error = self._energy = self._length = 0.0
        # Heading since the start, turns counted, and the last one measured [rad].
        self._yaw = self._last = 0.0
        # Sums over whole minutes: heading error [rad] and lateral drift [m] at their ends, and how many there were.
        self._turned = self._aside = 0.0
        self._minutes = 0
        self._anchor(0.0, 0.0)

    def _anchor(self, x: float, y: float) -> None:
        """Begin the commanded path anew, at a place and the present heading."""
        self._since = self._seconds
        self._wanted = self._yaw
        self._x = x
        self._y = y
        self._away = 0.0

    def move(
        self, place: Sequence[float], speeds: Sequence[float], command: Command, joules: float, seconds: float
    ) -> None:
        """Record a step: x, y, heading after it; forward and lateral velocity; command; positive work; its length."""
        x, y, yaw = place
        forward, lateral, rate = command
        self._yaw += math.remainder(yaw - self._last, math.tau)
        self._last = yaw

        # The commanded path goes on.
        speed = math.hypot(forward, lateral)
        angle = self._wanted + math.atan2(lateral, forward)
        self._x += speed * math.cos(angle) * seconds
        self._y += speed * math.sin(angle) * seconds
        self._wanted += rate * seconds

        self._seconds += seconds
        self._energy += joules
        self._error += math.hypot(forward - speeds[0], lateral - speeds[1]) * seconds
        self._length += math.hypot(*speeds) * seconds

        # Distance from the path: across it, or from the place where the robot should stand.
        ahead = x - self._x
        left = y - self._y
        if speed:
            self._away = abs(left * math.cos(angle) - ahead * math.sin(angle))
        else:
            self._away = math.hypot(ahead, left)
        if self._seconds - self._since >= MINUTE - 1e-6:
            self._turned += abs(self._yaw - self._wanted)
            self._aside += self._away
            self._minutes += 1
            self._anchor(x, y)

    def measures(self) -> dict[str, float | None]:
        """Return columns of the table (`MEASURES`) over all whole minutes; before the first one ends, in proportion."""
        turned = self._turned
        aside = self._aside
        minutes = float(self._minutes)
        if not minutes:
            turned = abs(self._yaw - self._wanted)
            aside = self._away
            minutes = self._seconds / MINUTE
        energy_per_meter = None
        if self._length > 1.0:
            energy_per_meter = self._energy / self._length
        return {
            "heading_error": math.degrees(turned) / minutes,
            "lateral_drift": aside / minutes,
            "velocity_error": self._error / self._seconds,
            "energy_per_meter": energy_per_meter,
        }


# The environment


class VelocityCommandEnv(MujocoEnv):
    """See the module. `unwrapped` has MuJoCo's `model` and `data`, so that disturbances of perdure work on it."""

    policy_action: FloatArray | None = None
    """What `actions` observes of the next step, if not the action that acts there; set before the step."""

    metadata: dict[str, Any] = {"render_modes": ["human", "rgb_array", "depth_array", "rgbd_tuple"]}  # noqa: RUF012

    def __init__(self, robot: str | Path | Contract, render_mode: str | None = None, **options: Any) -> None:
        """Build the robot of a contract or of its YAML file; options are those of Gymnasium's `MujocoEnv`."""
        contract = robot if isinstance(robot, Contract) else read_contract(robot)
        self.contract = contract
        self._model = copy.copy(compiled(contract, render_mode is not None))  # disturbances change it
        decimation = contract.decimation or 1
        self.metadata = {**self.metadata, "render_fps": round(1.0 / (self._model.opt.timestep * decimation))}
        space = gymnasium.spaces.Box(-np.inf, np.inf, (contract.observation_size,), np.float64)
        options.setdefault("default_camera_config", {"trackbodyid": 1, "distance": 2.5, "elevation": -15.0})
        super().__init__(str(Path(contract.model).resolve()), decimation, space, render_mode, **options)
        self.action_space = gymnasium.spaces.Box(*action_range(self.model, contract), dtype=np.float64)
        self._robot = RobotState(contract, self.model, self.data)
        if contract.imu:
            imu_place(contract, self.model, self.data)  # raises if there is none
        self._targets = JointTargets(contract, self.model, self.data)
        self._correction = HeadingCorrection(contract)
        trunk = [self.model.body(name).id for name in contract.trunk] or [1]
        planes = self.model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE
        self._kinds = np.where(planes, FLOOR, np.where(np.isin(self.model.geom_bodyid, trunk), TRUNK, 0))
        self._cosine = math.cos(math.radians(contract.fall_tilt))
        self._schedule = Schedule(contract)
        self._observer = Observer(contract)
        self.observation_names = tuple(self._observer.names)
        self.init_qpos = self._standing()

    def _initialize_simulation(self) -> tuple[Any, Any]:
        return self._model, mujoco.MjData(self._model)

    def _standing(self) -> FloatArray:
        """Return the default pose just above the floor, shape (nq,)."""
        model = self.model
        data = self.data
        high = 10.0
        data.qpos[:7] = 0.0, 0.0, high, 1.0, 0.0, 0.0, 0.0
        places, pose = self._targets.default_pose()
        data.qpos[places] = pose
        mujoco.mj_forward(model, data)
        solid = np.flatnonzero(model.geom_contype | model.geom_conaffinity).tolist()
        touching = {*solid, *model.pair_geom1.tolist(), *model.pair_geom2.tolist()}
        geoms = [geom for geom in touching if self._kinds[geom] != FLOOR]
        floor = int(self._kinds.argmax())
        gaps = [mujoco.mj_geomDistance(model, data, floor, geom, 2.0 * high, None) for geom in geoms]
        data.qpos[2] += START_GAP - min(gaps, default=high)
        return np.array(data.qpos)

    def reset_model(self) -> FloatArray:
        """Stand on the floor in the default pose, heading along x, and return the first observation."""
        qpos = self.init_qpos.copy()
        joints = self._robot.positions
        qpos[joints] += self.np_random.uniform(-JOINT_NOISE, JOINT_NOISE, len(joints))
        self.set_state(qpos, np.zeros(self.model.nv))  # type: ignore[no-untyped-call]
        self._schedule.begin(self.np_random)
        self._observer.begin()
        self._robot.walked = -1.0
        self._walk = Walk()
        self._seconds = 0.0
        self._targets.begin()
        self._correction.begin()
        self._dt = float(self.dt)
        self._second = deque[float](maxlen=round(1.0 / self._dt))
        return self._observe(np.zeros(len(joints)))

    def step(self, action: Any) -> tuple[FloatArray, Any, bool, bool, dict[str, Any]]:
        """Make a control step; see the module."""
        data = self.data
        dt = self._dt
        action = np.asarray(action, np.float64)
        command = self._schedule.command
        self._targets.step(action, self.frame_skip)
        self._seconds += dt
        seen = action
        if self.policy_action is not None:
            seen = self.policy_action
        observation = self._observe(seen)
        self.policy_action = None

        forward, lateral, rate = command
        vx, vy, _ = self._robot.linear_velocity
        turning = self._robot.angular_velocity[2]
        linear = (forward - vx) ** 2 + (lateral - vy) ** 2
        angular = (rate - turning) ** 2
        reward = math.exp(-linear / LINEAR_VARIANCE - angular / ANGULAR_VARIANCE)
        joules = float(np.maximum(data.actuator_force * data.actuator_velocity, 0.0).sum()) * dt
        self._walk.move(self._robot.place, (vx, vy), command, joules, dt)
        self._second.append(reward)
        fell = self._fell()
        if fell:
            reward -= sum(self._second)
        return observation, reward, fell, False, self._walk.measures()

    def sensors(self) -> dict[str, FloatArray]:
        """Return what a robot measures now and what it is told, as the arrays of `perdure.robots.trace.WIDTHS`."""
        robot = self._robot
        found = {
            "quaternion": self.data.qpos[3:7],
            "angular_velocity": robot.angular_velocity,
            "linear_velocity": robot.linear_velocity,
            "joint_pos": self.data.qpos[robot.positions],
            "joint_vel": self.data.qvel[robot.velocities],
            "command": robot.command,
        }
        return {name: np.array(values) for name, values in found.items()}

    def _observe(self, action: FloatArray) -> FloatArray:
        """Return the observation after a step with this action."""
        robot = self._robot
        robot.read_base()
        robot.action = action
        command = self._schedule.at(self._seconds)
        robot.walk_on(command, self._dt)
        rate = self._correction.rate(command, robot.place[2], self._dt)
        robot.command = (command[0], command[1], rate)
        return self._observer.read(robot)

    def _fell(self) -> bool:
        if self._robot.upright < self._cosine:
            return True
        touching = self._kinds[self.data.contact.geom].sum(axis=1)
        return bool((touching == TRUNK + FLOOR).any())
