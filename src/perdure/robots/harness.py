"""The harness of a robot: what stands between the policy's action and the motors, and between the user and the policy.

It delays joint targets, holds the joints that the policy does not drive, limits torques at high speeds, and turns a
robot back to its heading.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np

from perdure.robots.contract import Contract, FloatArray

UNLIMITED = 1e9
"""Torque [N m] of a joint without a torque limit, and share of it of a motor whose torque does not fall with speed."""
MOST_TURNING = 1.0
"""Largest yaw rate of a heading correction [rad/s]."""


def held_joints(contract: Contract, joints: Sequence[str]) -> dict[str, tuple[float, float, float]]:
    """Return pose, stiffness and damping of the joints of a model that the harness holds, by name.

    Raises:
        PerdureError: If an entry of `held` matches no joint, or only joints that the policy drives.
    """
    free = [name for name in joints if name not in contract.joints]
    found = {}
    for each in contract.held:
        found.update(each.matched(free))
    return found


def hinges(model: Any) -> list[str]:
    """Return the names of the joints of a model that can be driven, in its order."""
    kinds = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
    return [model.joint(k).name for k in range(model.njnt) if int(model.jnt_type[k]) in kinds]


class JointTargets:
    """Drives the joints of a robot: the contract's, then those that the harness holds."""

    def __init__(self, contract: Contract, model: Any, data: Any) -> None:
        self._model = model
        self._data = data
        self._pose = contract.values("default_pose")
        self._scale = contract.values("action_scale")
        self._held = [pose for pose, _, _ in held_joints(contract, hinges(model)).values()]
        joints = model.actuator_trnid[:, 0]
        self._positions = model.jnt_qposadr[joints]
        self._velocities = model.jnt_dofadr[joints]
        self._delay = contract.action_delay
        self.begin()

        # Motors whose torque depends on their speed: torque at standstill as a share of the torque limit.
        self._speeds: FloatArray | None = None
        if contract.velocity_limit is not None:
            driven = len(contract.joints)
            self._speeds = np.full(len(joints), np.inf)
            self._speeds[:driven] = contract.values("velocity_limit")
            self._shares = np.full(len(joints), UNLIMITED)
            if contract.saturation_effort is not None:
                self._shares[:driven] = contract.values("saturation_effort") / self._torque_limits()[:driven]

    def begin(self) -> None:
        """Begin an episode: the first targets are the default pose."""
        self._waiting = deque([np.zeros(len(self._pose))] * self._delay)

    def default_pose(self) -> tuple[Any, FloatArray]:
        """Return the places of all driven joints in `qpos`, and their default or held positions."""
        return self._positions, np.concatenate([self._pose, self._held])

    def step(self, action: FloatArray, steps: int) -> None:
        """Make so many physics steps with the targets of an action, or of an earlier one under a delay."""
        if self._delay:
            self._waiting.append(action)
            action = self._waiting.popleft()
        targets = self._pose + self._scale * action
        if self._held:
            targets = np.concatenate([targets, self._held])
        if self._speeds is None:
            self._data.ctrl[:] = targets
            mujoco.mj_step(self._model, self._data, nstep=steps)
            return
        for _ in range(steps):
            self._data.ctrl[:] = self._within_limits(targets, self._speeds)
            mujoco.mj_step(self._model, self._data)

    def _torque_limits(self) -> FloatArray:
        """Return the largest torque of each joint, which disturbances may change; shape (driven joints,)."""
        limited = self._model.actuator_forcelimited.astype(bool)
        return np.where(limited, self._model.actuator_forcerange[:, 1], UNLIMITED)

    def _within_limits(self, targets: FloatArray, speeds: FloatArray) -> FloatArray:
        """Return targets at which the controllers ask for no more torque than the motors have at their speeds."""
        stiffness = np.maximum(self._model.actuator_gainprm[:, 0], 1e-9)
        place = self._data.qpos[self._positions]
        speed = self._data.qvel[self._velocities]
        braking = self._model.actuator_biasprm[:, 2] * speed
        limits = self._torque_limits()
        high = _available(limits, self._shares * (1.0 - speed / speeds))
        low = -_available(limits, self._shares * (1.0 + speed / speeds))
        torque = (stiffness * (targets - place) + braking).clip(low, high)
        found: FloatArray = place + (torque - braking) / stiffness
        return found


def _available(limits: FloatArray, shares: FloatArray) -> FloatArray:
    """Return shares of the torque limits, at least 0; infinity for all of them, which the simulator itself limits."""
    return np.where(shares >= 1.0, np.inf, limits * shares.clip(0.0, 1.0))


class HeadingCorrection:
    """The yaw rate that a robot is told: its command, or back to its heading while it walks and is told no turn."""

    def __init__(self, contract: Contract) -> None:
        self._stiffness = contract.heading_control_stiffness
        self._gain = contract.heading_control_integral
        self.begin()

    def begin(self) -> None:
        """Begin an episode, heading along x."""
        self._wanted = 0.0
        self._turned = 0.0  # what the integral adds [rad/s]

    def rate(self, command: Sequence[float], heading: float, seconds: float) -> float:
        """Return the yaw rate [rad/s] that a robot with this command and heading [rad] is told for some seconds."""
        if command[2] or not any(command):
            self._wanted = heading
            self._turned = 0.0
        error = math.remainder(self._wanted - heading, math.tau)
        correction = self._stiffness * error + self._turned
        self._turned = _bounded(self._turned + self._gain * error * seconds)
        return command[2] + _bounded(correction)


def _bounded(rate: float) -> float:
    return min(MOST_TURNING, max(-MOST_TURNING, rate))
