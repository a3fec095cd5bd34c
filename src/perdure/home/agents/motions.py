"""Motions of base and arm that the oracle is made of: drive, turn, reach, back off where something is in the way."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import zip_longest

import numpy as np

from perdure.home.agents.learned import LaneView, Motion
from perdure.home.sim.arrays import FloatArray
from perdure.home.sim.kinematics import damped_inverse, pose_and_jacobian
from perdure.home.sim.pieces import Pose
from perdure.home.sim.robot import ROBOT
from perdure.home.sim.scene import CONTROL_HZ
from perdure.home.sim.sensors import wrap
from perdure.home.sim.simulator import ARM_STEP, LEAVE, Simulator
from perdure.home.sim.vector_simulator import VectorSimulator
from perdure.home.skills import rest_error

PATIENCE = 15
"""Steps after which a robot that has hardly moved counts as stuck."""
CREEP = 0.04
"""Smallest motion in that time in [m] (0.3 m for a radian)."""
TRIES = 3
"""Number of times a robot backs off on a path before it gives up."""
JAMMED_RAD = 0.25
"""Lag of a joint in [rad] beyond which the arm is jammed."""
AHEAD = 6
"""Look-ahead on a path in waypoints of 5 cm."""
ARRIVED_RAD = 0.02
"""Largest lag of a joint in [rad] at which an arm pose counts as reached."""


@dataclass
class View(LaneView):
    """One lane of an oracle skill."""

    world: VectorSimulator
    number: int
    base_speed: float
    """Speed of a base action of 1 in [m/s] and [rad/s]."""

    @property
    def simulator(self) -> Simulator:
        """The simulator of the lane: an oracle may know everything."""
        return self.world.simulator(self.number)

    @property
    def jammed(self) -> bool:
        """Whether an obstacle keeps the arm from its servo targets."""
        return float(np.abs(self.state.arm_target[0] - self.state.arm[0]).max()) > JAMMED_RAD

    def action(
        self, forward: float = 0.0, turn: float = 0.0, arm: FloatArray | None = None, grip: float = LEAVE
    ) -> FloatArray:
        """Return an action from speeds in [m/s] and [rad/s] and joint steps in [rad]."""
        action = np.zeros(ROBOT.action_size)
        action[ROBOT.action.forward] = forward / self.base_speed
        action[ROBOT.action.turn] = turn / self.base_speed
        action[ROBOT.action.grip] = grip
        if arm is not None:
            action[ROBOT.action.arm] = arm / ARM_STEP
        return np.clip(action, -1.0, 1.0)


def arm_step(way: FloatArray) -> FloatArray:
    """Return the joint steps of a way, shortened so that no joint moves farther than allowed. Shape (joints,)."""
    return way / max(1.0, float(np.abs(way).max()) / ARM_STEP)


def move_arm(
    view: View, poses: Sequence[FloatArray], settle: int = 10, until: Callable[[], bool] = lambda: False
) -> Motion:
    """Move through some arm poses in straight lines of joint space; wait up to `settle` steps for the lag to go.

    Rolls go the shorter way round. Ends early as soon as `until` holds.
    """
    for pose in poses:
        goal = unwound(pose, view.arm)
        while np.abs(goal - view.arm).max() > 1e-9:
            if until():
                return
            yield view.action(arm=arm_step(goal - view.arm))
    yield from settled(view, settle)


def unwound(pose: FloatArray, now: FloatArray) -> FloatArray:
    """Return the same arm pose with its endless rolls within half a turn of their present angles. Shape (joints,)."""
    same = pose.copy()
    same[ROBOT.continuous] += 2.0 * np.pi * np.round((now - pose)[ROBOT.continuous] / (2.0 * np.pi))
    return same


def settled(view: View, steps: int = 10) -> Motion:
    """Wait up to some steps until the arm has reached its servo targets."""
    for _ in range(steps):
        if np.abs(view.state.arm[0] - view.arm).max() < ARRIVED_RAD:
            return
        yield view.action()


def rest_arm(view: View) -> Motion:
    """Move the arm to its pose of rest, rolls the shorter way round."""
    yield from move_arm(view, [ROBOT.rest_arm], settle=15)


def turn_and_go(view: View, yaw: float, distance: float, until: Callable[[], bool] = lambda: False) -> Motion:
    """Turn to a heading, then drive straight on (back when negative) by a distance, or until something holds."""
    yield from turn_to(view, yaw)
    start = view.base
    along = np.array([np.cos(yaw), np.sin(yaw)])
    for _ in range(int(30 + 60 * abs(distance))):
        gone = float((np.array([view.base.x, view.base.y]) - (start.x, start.y)) @ along)
        left = distance - gone
        if abs(left) < 0.01 or until():
            break
        error = float(wrap(np.array(yaw - view.base.yaw)))
        yield view.action(forward=float(np.clip(4.0 * left, -1.0, 1.0)), turn=float(np.clip(4.0 * error, -1.0, 1.0)))
    yield view.action()


def turn_to(view: View, yaw: float) -> Motion:
    """Turn on the spot to a heading; where something is in the way back off, then turn the other way round."""
    stuck = Stuck()
    direction = 0.0
    for _ in range(200):
        error = float(wrap(np.array(yaw - view.base.yaw)))
        if abs(error) < 0.02:
            return
        if direction and abs(error) > 0.3 and np.sign(error) != direction:
            error += direction * 2.0 * np.pi
        yield view.action(turn=float(np.clip(5.0 * error, -2.0, 2.0)))
        if stuck.after(view.base) or view.jammed:
            yield from back_off(view)
            direction = 0.0
            if stuck.count > 1:
                direction = -float(np.sign(error))


def follow(view: View, points: FloatArray) -> Motion:
    """Drive along close waypoints, always towards the one a little ahead; back off where the robot gets stuck.

    Ends before the last one where it got stuck again and again.
    """
    stuck = Stuck()
    here = 0
    backed = 0
    last = len(points) - 1
    for _ in range(450):
        # The waypoint that the robot is at; only those a little ahead are looked at, as a way may cross itself.
        now = np.array([view.base.x, view.base.y])
        away = np.linalg.norm(points[here : here + 12] - now, axis=1)
        here += int(away.argmin())
        if here >= last - 1 and np.linalg.norm(points[last] - now) < 0.03:
            return

        # Turn toward a point ahead, and drive the faster the farther it is.
        ahead = points[min(here + AHEAD, last)] - now
        far = float(np.hypot(*ahead))
        left = float(np.linalg.norm(points[last] - now))
        error = float(wrap(np.arctan2(ahead[1], ahead[0]) - view.base.yaw))
        if left < 0.12 and abs(error) > 0.5 * np.pi:
            return
        slow = max(0.0, np.cos(error)) ** 8  # on the spot until the heading is right
        if here + AHEAD < last:
            left = max(left, far)
        speed = float(np.clip(3.0 * left, 0.05, 1.3))
        yield view.action(forward=speed * slow, turn=float(np.clip(5.0 * error, -2.5, 2.5)))

        # Back off where the robot or its arm is caught, and try again from a little before.
        if stuck.after(view.base) or view.jammed:
            yield from back_off(view)
            here = max(here - 4, 0)
            backed += 1
            if backed > TRIES:
                return


def unjam(view: View) -> Motion:
    """Drive straight back until the arm is free."""
    for _ in range(20):
        if not view.jammed:
            return
        yield view.action(forward=-0.6)


def back_off(view: View) -> Motion:
    """Drive a short way straight back: what blocks the robot is nearly always before it, where its arm is."""
    for _ in range(12):
        yield view.action(forward=-0.6)


@dataclass
class Stuck:
    """Whether a robot that should move has hardly moved for a while; one whose arm is caught still creeps."""

    steps: int = 0
    count: int = 0
    """How often it got stuck."""
    anchor: Pose | None = None
    """Where it was when counting began."""

    def after(self, base: Pose) -> bool:
        """Return one step on: True when it has hardly moved for `PATIENCE` steps; then counting begins anew."""
        self.anchor = self.anchor or base
        self.steps += 1
        if self.steps < PATIENCE:
            return False
        old = self.anchor
        self.anchor = base
        self.steps = 0
        turned = abs(float(wrap(np.array(base.yaw - old.yaw))))
        stuck = abs(base.x - old.x) + abs(base.y - old.y) + 0.3 * turned < CREEP
        self.count += stuck
        return stuck


def reach_for(view: View, point: FloatArray, speed: float, tool: FloatArray) -> FloatArray:
    """Return joint steps that move a point of the hand toward a point of the room; rotation is free. Shape (joints,).

    Damped least squares; what the three equations leave open draws the arm to its pose of rest. `tool` is the point of
    the hand, from the gripper point along the gripper's axes; `speed` in [m/s] is the largest. Points of shape (3,).
    """
    position, rotation, matrix = pose_and_jacobian(ROBOT.torso_height, view.arm)
    arm = rotation @ tool
    away = view.base.to_local(point) - position - arm
    far = float(np.linalg.norm(away))
    away = away * min(1.0, speed / CONTROL_HZ / max(far, 1e-9))
    rows = matrix[:3] + np.cross(matrix[3:].T, arm).T
    inverse = damped_inverse(rows, 0.03)
    home = np.clip(0.02 * rest_error(view.state.arm_target)[0], -0.01, 0.01)
    step = inverse @ away + (np.eye(len(ROBOT.arm)) - inverse @ rows) @ home
    return np.asarray(np.clip(view.arm + arm_step(step), ROBOT.arm_low, ROBOT.arm_high) - view.arm)


def together(first: Motion, second: Motion) -> Motion:
    """Run two motions at once, of base and arm, until both have ended; their actions are added."""
    for actions in zip_longest(first, second, fillvalue=np.zeros(ROBOT.action_size)):
        yield np.clip(sum(actions, np.zeros(ROBOT.action_size)), -1.0, 1.0)
