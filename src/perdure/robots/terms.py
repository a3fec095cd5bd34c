"""Observation terms of legged robots: what a policy may observe, each with its size and its value in the simulator.

A term is a subclass of `ObservationTerm`, found by its name as soon as it is defined, also in another package (see
`perdure.registry`). Contracts name terms; scale, clip and history are theirs.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from perdure.errors import PerdureError, did_you_mean
from perdure.registry import Registered

if TYPE_CHECKING:
    from perdure.robots.contract import Contract

STANDING = 0.01
"""A smaller command means standing: the phases of the gait are then 0.5, as in holosoma."""


class RobotState:
    """What observation terms read: the simulator of a robot, its base after a step, and what it is told."""

    def __init__(self, contract: Contract, model: Any, data: Any) -> None:
        self.contract = contract
        self.model = model
        self.data = data
        joints = [model.joint(name).id for name in contract.joints]
        self.positions = model.jnt_qposadr[joints]
        """Places of the contract's joints in `data.qpos`, shape (joints,)."""
        self.velocities = model.jnt_dofadr[joints]
        """Their places in `data.qvel`, shape (joints,)."""
        self.default_pose = contract.values("default_pose")
        self.command: Sequence[float] = (0.0, 0.0, 0.0)
        """Forward and lateral velocity [m/s] and yaw rate [rad/s] that the robot is told."""
        self.action: NDArray[np.float64] = np.zeros(len(joints))
        """The last action, shape (joints,)."""
        self.walked = -1.0
        """Time of the gait [s]: since the robot was told to walk; -1 while it stands still."""
        self._imu_values: list[list[float]] = []

    def read_base(self) -> None:
        """Read place, velocities and tilt of the base. In Python's numbers: NumPy's calls would cost more."""
        x, y, _, qw, qx, qy, qz = self.data.qpos[:7].tolist()
        vx, vy, vz, *turn = self.data.qvel[:6].tolist()
        # The axes of the base in the frame of the world.
        along = 1.0 - 2.0 * (qy * qy + qz * qz), 2.0 * (qx * qy + qw * qz), 2.0 * (qx * qz - qw * qy)
        left = 2.0 * (qx * qy - qw * qz), 1.0 - 2.0 * (qx * qx + qz * qz), 2.0 * (qy * qz + qw * qx)
        up = 2.0 * (qx * qz + qw * qy), 2.0 * (qy * qz - qw * qx), 1.0 - 2.0 * (qx * qx + qy * qy)
        self._axes = along, left, up
        self._imu_values = []
        self.place = (x, y, math.atan2(along[1], along[0]))
        """x, y [m] and heading [rad] in the frame of the world."""
        self.linear_velocity = [vx * axis[0] + vy * axis[1] + vz * axis[2] for axis in (along, left, up)]
        """In the frame of the base [m/s]."""
        self.world_velocity = [vx, vy, vz]
        """Linear velocity of the base in the frame of the world [m/s]."""
        self.angular_velocity: list[float] = turn
        """In the frame of the base [rad/s]."""
        self.gravity = [-along[2], -left[2], -up[2]]
        """Direction of gravity in the frame of the base."""
        self.upright = up[2]
        """Cosine of the tilt."""

    @property
    def world_turning(self) -> list[float]:
        """Angular velocity of the base in the frame of the world [rad/s]."""
        parts = zip(*self._axes, strict=True)
        return [sum(rate * axis for rate, axis in zip(self.angular_velocity, each, strict=True)) for each in parts]

    @property
    def imu(self) -> list[list[float]]:
        """Linear velocity, angular velocity and direction of gravity in the frame of the contract's IMU."""
        if not self.contract.imu:
            return [self.linear_velocity, self.angular_velocity, self.gravity]
        if not self._imu_values:
            self._imu_values = self._read_imu()
        return self._imu_values

    def _read_imu(self) -> list[list[float]]:
        import mujoco

        model = self.model
        data = self.data
        kind, number, axes = imu_place(self.contract, model, data)
        # A step of the simulator leaves frames and velocities as they were before its last integration.
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_comVel(model, data)
        both = np.zeros(6)
        mujoco.mj_objectVelocity(model, data, kind, number, both, 1)
        down = -axes[number].reshape(3, 3)[2]
        return [both[3:].tolist(), both[:3].tolist(), down.tolist()]

    def walk_on(self, command: Sequence[float], seconds: float) -> None:
        """Go on with the gait for so many seconds under a command; see `gait_while_standing` for one of zero."""
        stands = math.hypot(command[0], command[1]) < STANDING and abs(command[2]) < STANDING
        if stands and self.contract.gait_while_standing == "stop":
            self.walked = -1.0
        elif self.walked < 0.0:
            self.walked = 0.0
        else:
            self.walked += seconds

    @property
    def phases(self) -> list[float]:
        """The phases of the gait [rad], one for each of the contract's offsets."""
        if self.walked < 0.0:
            return [math.tau * 0.5] * len(self.contract.gait_offsets)
        begun = self.walked / self.contract.gait_period
        return [math.tau * (begun + each) for each in self.contract.gait_offsets]


def imu_place(contract: Contract, model: Any, data: Any) -> tuple[int, int, Any]:
    """Return kind and number of the contract's IMU, and the rotations of all objects of its kind.

    Raises:
        PerdureError: If the model has no site and no body of this name.
    """
    import mujoco

    name = contract.imu
    for kind, turns in ((mujoco.mjtObj.mjOBJ_SITE, data.site_xmat), (mujoco.mjtObj.mjOBJ_BODY, data.xmat)):
        number = mujoco.mj_name2id(model, kind, name)
        if number >= 0:
            if kind == mujoco.mjtObj.mjOBJ_BODY:
                kind = mujoco.mjtObj.mjOBJ_XBODY  # in the body's own frame, not in that of its inertia
            return int(kind), number, turns
    sites = [model.site(k).name for k in range(model.nsite)]
    hint = did_you_mean(name, sites) or f"; its sites are {', '.join(sites)}"
    raise PerdureError(f"imu: the model has no site or body {name!r}{hint}")


class ObservationTerm(Registered):
    """One quantity that a policy observes."""

    words: ClassVar[str]
    """What it is, with its unit."""
    components: ClassVar[int] = 3
    """Numbers in one step, where every robot has as many."""
    aliases: ClassVar[tuple[str, ...]] = ()
    """What Isaac Lab, rl_sar, holosoma and Unitree's code call it."""

    @classmethod
    def size(cls, contract: Contract) -> int:
        """Return how many numbers it has in one step."""
        return cls.components

    @abstractmethod
    def value(self, robot: RobotState) -> Any:
        """Return these numbers: a list or an array of shape (size,), before scale and clip."""


class BaseLinearVelocity(ObservationTerm):
    """See `words`."""

    name = "base_lin_vel"
    words = "linear velocity of the base in its own frame [m/s]"

    def value(self, robot: RobotState) -> Any:
        """See `ObservationTerm.value`."""
        return robot.linear_velocity


class BaseAngularVelocity(ObservationTerm):
    """See `words`."""

    name = "base_ang_vel"
    words = "angular velocity of the base in its own frame [rad/s]"
    aliases = ("ang_vel",)

    def value(self, robot: RobotState) -> Any:
        """See `ObservationTerm.value`."""
        return robot.angular_velocity


class WorldLinearVelocity(ObservationTerm):
    """See `words`."""

    name = "base_lin_vel_w"
    words = "linear velocity of the base in the frame of the world [m/s]"
    aliases = ("root_lin_vel_w",)

    def value(self, robot: RobotState) -> Any:
        """See `ObservationTerm.value`."""
        return robot.world_velocity


class WorldAngularVelocity(ObservationTerm):
    """See `words`."""

    name = "base_ang_vel_w"
    words = "angular velocity of the base in the frame of the world [rad/s]"
    aliases = ("root_ang_vel_w",)

    def value(self, robot: RobotState) -> Any:
        """See `ObservationTerm.value`."""
        return robot.world_turning


class ImuLinearVelocity(ObservationTerm):
    """See `words`."""

    name = "imu_lin_vel"
    words = "linear velocity of the IMU in its own frame [m/s]; its place is the contract's `imu`"

    def value(self, robot: RobotState) -> Any:
        """See `ObservationTerm.value`."""
        return robot.imu[0]


class ImuAngularVelocity(ObservationTerm):
    """See `words`."""

    name = "imu_ang_vel"
    words = "angular velocity of the IMU in its own frame [rad/s]"

    def value(self, robot: RobotState) -> Any:
        """See `ObservationTerm.value`."""
        return robot.imu[1]


class ImuGravity(ObservationTerm):
    """See `words`."""

    name = "imu_projected_gravity"
    words = "direction of gravity in the frame of the IMU"

    def value(self, robot: RobotState) -> Any:
        """See `ObservationTerm.value`."""
        return robot.imu[2]


class ProjectedGravity(ObservationTerm):
    """See `words`."""

    name = "projected_gravity"
    words = "direction of gravity in the frame of the base"
    aliases = ("gravity_vec",)

    def value(self, robot: RobotState) -> Any:
        """See `ObservationTerm.value`."""
        return robot.gravity


class VelocityCommand(ObservationTerm):
    """See `words`."""

    name = "command"
    words = "commanded forward and lateral velocity [m/s] and yaw rate [rad/s]"
    aliases = ("velocity_commands", "commands", "twist")

    def value(self, robot: RobotState) -> Any:
        """See `ObservationTerm.value`."""
        return robot.command


class JointPositions(ObservationTerm):
    """See `words`."""

    name = "joint_pos"
    words = "joint positions relative to the default pose [rad]"
    aliases = ("joint_pos_rel", "dof_pos")

    @classmethod
    def size(cls, contract: Contract) -> int:
        """Return the number of joints."""
        return len(contract.joints)

    def value(self, robot: RobotState) -> Any:
        """See `ObservationTerm.value`."""
        return robot.data.qpos.take(robot.positions) - robot.default_pose


class AbsoluteJointPositions(ObservationTerm):
    """See `words`."""

    name = "joint_pos_abs"
    words = "joint positions [rad]"

    @classmethod
    def size(cls, contract: Contract) -> int:
        """Return the number of joints."""
        return len(contract.joints)

    def value(self, robot: RobotState) -> Any:
        """See `ObservationTerm.value`."""
        return robot.data.qpos.take(robot.positions)


class JointVelocities(ObservationTerm):
    """See `words`."""

    name = "joint_vel"
    words = "joint velocities [rad/s]"
    aliases = ("joint_vel_rel", "dof_vel")

    @classmethod
    def size(cls, contract: Contract) -> int:
        """Return the number of joints."""
        return len(contract.joints)

    def value(self, robot: RobotState) -> Any:
        """See `ObservationTerm.value`."""
        return robot.data.qvel.take(robot.velocities)


class LastAction(ObservationTerm):
    """See `words`."""

    name = "actions"
    words = "the policy's last action, 0 at first"
    aliases = ("last_action",)

    @classmethod
    def size(cls, contract: Contract) -> int:
        """Return the number of joints."""
        return len(contract.joints)

    def value(self, robot: RobotState) -> Any:
        """See `ObservationTerm.value`."""
        return robot.action


class LinearVelocityCommand(ObservationTerm):
    """See `words`."""

    name = "command_lin_vel"
    words = "commanded forward and lateral velocity [m/s]"
    components = 2

    def value(self, robot: RobotState) -> Any:
        """See `ObservationTerm.value`."""
        return robot.command[:2]


class YawRateCommand(ObservationTerm):
    """See `words`."""

    name = "command_ang_vel"
    words = "commanded yaw rate [rad/s]"
    components = 1

    def value(self, robot: RobotState) -> Any:
        """See `ObservationTerm.value`."""
        return robot.command[2:]


class SinePhases(ObservationTerm):
    """See `words`."""

    name = "sin_phase"
    words = "sine of each phase of the gait"

    @classmethod
    def size(cls, contract: Contract) -> int:
        """Return the number of phases."""
        return len(contract.gait_offsets)

    def value(self, robot: RobotState) -> Any:
        """See `ObservationTerm.value`."""
        return [math.sin(phase) for phase in robot.phases]


class CosinePhases(ObservationTerm):
    """See `words`."""

    name = "cos_phase"
    words = "cosine of each phase of the gait"

    @classmethod
    def size(cls, contract: Contract) -> int:
        """Return the number of phases."""
        return len(contract.gait_offsets)

    def value(self, robot: RobotState) -> Any:
        """See `ObservationTerm.value`."""
        return [math.cos(phase) for phase in robot.phases]


class GaitPhase(ObservationTerm):
    """See `words`."""

    name = "gait_phase"
    words = "sine and cosine of one gait clock, the first of the phases"
    components = 2

    def value(self, robot: RobotState) -> Any:
        """See `ObservationTerm.value`."""
        first = robot.phases[0]
        return [math.sin(first), math.cos(first)]


def term_name(name: str) -> str | None:
    """Return the name of the term that a name or an alias means; None if there is none."""
    kinds = ObservationTerm.kinds()
    if name in kinds:
        return name
    return next((kind.name for kind in kinds.values() if name in kind.aliases), None)
