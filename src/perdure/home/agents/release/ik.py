"""`ik`: the thesis' hand-over. Freeze the policy, hold the base still, descend by epsilon, release."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from perdure.home.agents.release.hand_over import HandOver, Held, Motion, hold_base, stop, stop_above_goal
from perdure.home.sim.robot import TORSO_HEIGHT, gripper_pose, reach, toward
from perdure.home.sim.world import CONTROL_HZ

EPSILON = 0.05
"""Depth of the descent in [m]; `docs/home/world.md` compares other values."""
SPEED = 0.15
"""Speed of the descent in [m/s]."""
OUT_OF_REACH = 0.02
"""Largest error in [m] of a reached end point; beyond it the point counts as out of reach."""


@dataclass
class Ik(HandOver):
    """The end effector goes from (x, y, z) to (x, y, z - epsilon) by inverse kinematics (thesis, section 2.2).

    The thesis assumes that (x, y, z) is directly above the goal region; here it is checked. When it is not (outcome
    "not above the goal"), or (x, y, z - epsilon) is out of reach ("out of reach"), the object is released where the
    stop ended. When an obstacle ends the descent early (the servos lag), it is released there ("blocked").
    """

    name = "ik"
    epsilon: float = EPSILON
    speed: float = SPEED

    def motion(self, held: Held) -> Motion:
        """See `HandOver.motion`."""
        if not (yield from stop_above_goal(held)):
            return
        start = held.state.gripper_in_base[0].copy()
        rotation = held.state.gripper_rotation[0].copy()
        end = start - (0.0, 0.0, self.epsilon)
        if reach(end, held.arm, rotation=rotation, restarts=0).position_error > OUT_OF_REACH:
            held.outcome = "out of reach"
            return
        step, steps = self.speed / CONTROL_HZ, int(np.ceil(self.epsilon * CONTROL_HZ / self.speed))
        wanted = start.copy()
        for _ in range(steps):
            wanted = wanted - (0.0, 0.0, min(step, wanted[2] - end[2]))
            # From where the servos' targets would put the gripper: what the arm lags behind is not made up for.
            yield hold_base(held, toward(held.arm, wanted - gripper_pose(TORSO_HEIGHT, held.arm)[0], rotation=rotation))
        yield from stop(held)
        if np.linalg.norm(held.state.gripper_in_base[0] - end) > OUT_OF_REACH:
            held.outcome = "blocked"
