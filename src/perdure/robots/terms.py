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
        joints = model.actuator_trnid[:, 0]
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
        """Seconds since the robot was told to walk; -1 while it is told to stand."""

    def read_base(self) -> None:
        """Read place, velocities and tilt of the base. In Python's numbers: NumPy's calls would cost more."""
        x, y, _, qw, qx, qy, qz = self.data.qpos[:7].tolist()
        vx, vy, vz, *turn = self.data.qvel[:6].tolist()
        # The axes of the base in the frame of the world.
        along = 1.0 - 2.0 * (qy * qy + qz * qz), 2.0 * (qx * qy + qw * qz), 2.0 * (qx * qz - qw * qy)
        left = 2.0 * (qx * qy - qw * qz), 1.0 - 2.0 * (qx * qx + qz * qz), 2.0 * (qy * qz + qw * qx)
        up = 2.0 * (qx * qz + qw * qy), 2.0 * (qy * qz - qw * qx), 1.0 - 2.0 * (qx * qx + qy * qy)
        self.place = (x, y, math.atan2(along[1], along[0]))
        """x, y [m] and heading [rad] in the frame of the world."""
        self.linear_velocity = [vx * axis[0] + vy * axis[1] + vz * axis[2] for axis in (along, left, up)]
        """In the frame of the base [m/s]."""
        self.angular_velocity: list[float] = turn
        """In the frame of the base [rad/s]."""
        self.gravity = [-along[2], -left[2], -up[2]]
        """Direction of gravity in the frame of the base."""
        self.upright = up[2]
        """Cosine of the tilt."""

    def walk_on(self, command: Sequence[float], seconds: float) -> None:
        """Go on with the gait for so many seconds under a command; it stands still while the command is zero."""
        stands = math.hypot(command[0], command[1]) < STANDING and abs(command[2]) < STANDING
        if stands:
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


def term_name(name: str) -> str | None:
    """Return the name of the term that a name or an alias means; None if there is none."""
    kinds = ObservationTerm.kinds()
    if name in kinds:
        return name
    return next((kind.name for kind in kinds.values() if name in kind.aliases), None)
