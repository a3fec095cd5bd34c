"""Navigate: drive to where the next skill can begin, facing what it is about.

M3 has 20 discrete actions, one of them "stop"; ours are continuous speeds, and the robot stops by standing still. It
carries a map: a point of the planned way is part of the observation (M3's robot sees depth images and no map).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from perdure.home.skills.observation import PROPRIOCEPTION, SCAN, proprioception
from perdure.home.skills.skill import Element, Progress, Skill
from perdure.home.world import ARM, GRIP, NAVIGATION_SPEED, Sensors

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

NEAR, FACING = 0.1, 0.25
"""How near the region in [m] of way and how well turned in [rad] the robot must be (M3)."""
STILL_FORWARD, STILL_TURN = 0.05, 0.05
"""Below these speeds in [m/s] and [rad/s] the robot stands still."""
STILL_STEPS = 10
"""Steps of standing still that mean "stop" (OURS, in place of M3's stop action)."""
DISTANCE_REWARD = 1.0
FAR = 5.0
"""Ways longer than this look alike, in [m]."""


@dataclass(frozen=True)
class Navigate(Skill):
    """Reward (M3): 1 per metre of way nearer to the region."""

    name = "navigate"
    base_speed = NAVIGATION_SPEED
    failures = ("none",)

    @property
    def elements(self) -> tuple[Element, ...]:
        """See `Skill.elements`."""
        return (
            *PROPRIOCEPTION,
            Element("aim_in_base_x", "what to face, base frame x", "m"),
            Element("aim_in_base_y", "what to face, base frame y", "m"),
            Element("aim_distance", "how far that is along the floor", "m", 0.0),
            Element("aim_cos", "cosine of the turn that would face it", "1", -1.0, 1.0),
            Element("aim_sin", "sine of that turn", "1", -1.0, 1.0),
            Element("holding", "1 when something is held", "1", 0.0, 1.0),
            Element("waypoint_x", "point of the planned way 0.5 m ahead, base frame x", "m"),
            Element("waypoint_y", "point of the planned way 0.5 m ahead, base frame y", "m"),
            Element("way", "length of the planned way, up to 5 m", "m", 0.0, FAR),
            *SCAN,
        )

    def observe(self, sensors: Sensors, progress: Progress) -> FloatArray:
        """See `Skill.observe`."""
        aim = sensors.in_base(sensors.aim)
        far = np.sqrt(aim[:, 0] ** 2 + aim[:, 1] ** 2)
        safe = np.maximum(far, 1e-9)
        holding = (sensors.held >= 0).astype(np.float64)
        ahead = sensors.in_base(sensors.waypoint)
        columns = [aim[:, 0], aim[:, 1], far, aim[:, 0] / safe, aim[:, 1] / safe, holding]
        columns += [ahead[:, 0], ahead[:, 1], np.minimum(sensors.way, FAR)]
        return np.concatenate([*proprioception(sensors), np.stack(columns, axis=1), sensors.scan], axis=1)

    def terms(self, before: Sensors, after: Sensors, was: Progress, now: Progress) -> Mapping[str, FloatArray]:
        """See `Skill.terms`."""
        return {"way": DISTANCE_REWARD * (counted_way(before) - counted_way(after))}

    def success(self, sensors: Sensors, progress: Progress) -> BoolArray:
        """The robot stands still within 0.1 m of the region, turned to within 0.25 rad of what it should face."""
        there: BoolArray = (sensors.way <= NEAR) & (np.abs(sensors.facing_error) <= FACING)
        return there & (progress.lasting >= STILL_STEPS)

    def stop(self, sensors: Sensors, progress: Progress) -> BoolArray:
        """It has moved and stands still, wherever that is."""
        stands: BoolArray = progress.reached & (progress.lasting >= STILL_STEPS)
        return stands

    def mask(self, actions: FloatArray, sensors: Sensors) -> FloatArray:
        """Arm and gripper stay as they are."""
        masked = actions.copy()
        masked[:, ARM] = 0.0
        masked[:, GRIP] = 0.0
        return masked

    def _remember(self, progress: Progress, sensors: Sensors) -> Progress:
        speed = np.abs(sensors.base_velocity)
        still = (speed[:, 0] < STILL_FORWARD) & (speed[:, 2] < STILL_TURN)
        lasting = np.where(still, progress.lasting + 1, 0)
        # A robot that already stands right may stop at once; any other one has to have moved.
        right = (sensors.way <= NEAR) & (np.abs(sensors.facing_error) <= FACING)
        return replace(progress, lasting=lasting, reached=progress.reached | ~still | right)


def counted_way(sensors: Sensors) -> FloatArray:
    """The way to the region, as far as it counts: up to 0.05 m are none (M3). Shape (n,)."""
    return np.where(sensors.way <= 0.05, 0.0, sensors.way)
