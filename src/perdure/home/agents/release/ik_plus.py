"""`ik+`: ours. Turn the object upright if possible, lower it until contact, release, go up again."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from perdure.home.agents.release.hand_over import HandOver, Held, Motion, hold_base, stop, stop_above_goal
from perdure.home.sim.arrays import FloatArray
from perdure.home.sim.robot import gripper_pose, toward
from perdure.home.sim.robot.data import TORSO_HEIGHT
from perdure.home.sim.world import CONTROL_HZ

DEEPEST = 0.25
"""Largest depth of the descent in [m]."""
SPEED = 0.15
"""Speed of the descent in [m/s]."""
TURN_STEPS = 60
"""Steps in which the object is brought upright."""
UPRIGHT = float(np.cos(np.radians(20.0)))
"""Cosine of the tilt up to which an object stands rather than tips or rolls."""
BACK = 1.0 + 2.0 * float(np.cos(np.radians(6.0)))
"""Trace of a rotation by 6 degrees: the tolerance of turning back."""
CONTACT = 3.0
"""Normal force at the held object in [N] that counts as a contact."""


@dataclass
class IkPlus(HandOver):
    """Descent until contact, with the object upright (OURS, not in the thesis).

    The object's own z axis is turned to the vertical. Where joint limits or a contact leave a tilt of more than 20
    degrees, it is turned back, because an object released at such a tilt would tip over or roll. Then it descends until
    the held object (or the hand) feels a contact or has reached the largest depth (outcome "no contact").
    """

    name = "ik+"
    speed: float = SPEED
    deepest: float = DEEPEST

    def motion(self, held: Held) -> Motion:
        """See `HandOver.motion`."""
        if not (yield from stop_above_goal(held)):
            return
        place, now = gripper_pose(TORSO_HEIGHT, held.arm)
        yield from turn(held, place, upright(now), lambda r: r[2, 2] > 0.998 or touches(held))
        if gripper_pose(TORSO_HEIGHT, held.arm)[1][2, 2] < UPRIGHT:
            yield from turn(held, place, now, lambda r: bool(np.trace(r.T @ now) > BACK))
        held.outcome = "no contact"
        wanted, rotation = gripper_pose(TORSO_HEIGHT, held.arm)
        for _ in range(int(self.deepest * CONTROL_HZ / self.speed)):
            if touches(held):
                held.outcome = "done"
                break
            wanted = wanted - (0.0, 0.0, self.speed / CONTROL_HZ)
            position, _ = gripper_pose(TORSO_HEIGHT, held.arm)
            yield hold_base(held, toward(held.arm, wanted - position, rotation=rotation))
        yield from stop(held)


def turn(held: Held, place: FloatArray, wanted: FloatArray, there: Callable[[FloatArray], bool]) -> Motion:
    """Turn the held object about a fixed gripper point until the rotation is reached or the steps are used up."""
    for _ in range(TURN_STEPS):
        position, rotation = gripper_pose(TORSO_HEIGHT, held.arm)
        if there(rotation):
            return
        yield hold_base(held, toward(held.arm, place - position, rotation=wanted))


def touches(held: Held) -> bool:
    """Return whether the object (or the hand) feels a contact."""
    return bool(held.state.contact_force[0] > CONTACT)


def upright(rotation: FloatArray) -> FloatArray:
    """Return the rotation nearest to this one whose z axis points up. Shape (3, 3) -> (3, 3)."""
    z = rotation[:, 2]
    axis, cosine = np.cross(z, (0.0, 0.0, 1.0)), float(z[2])
    if cosine < -0.999:  # upside down: about its own x axis
        return rotation @ np.diag([1.0, -1.0, -1.0])
    skew = np.cross(np.eye(3), axis)
    return (np.eye(3) + skew + skew @ skew / (1.0 + cosine)) @ rotation
