"""Navigate: drive to where the next skill can begin, facing what it is about.

M3 has 20 discrete actions, one of them "stop"; ours are continuous speeds. The robot carries a map, as M3's does not: a
point of the planned way is part of the observation, and it stops where the map says that it has arrived.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from perdure.home.sim.world import ARM, GRIP, NAVIGATION_SPEED, SCAN_RANGE, STOP, PrivilegedState
from perdure.home.skills.observation import PROPRIOCEPTION, SCAN, proprioception
from perdure.home.skills.skill import Element, Progress, Skill, first_of

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]

NEAR, FACING = 0.1, 0.25
"""How near the region in [m] of way and how well turned in [rad] the robot must be (M3)."""
DISTANCE_REWARD = 1.0
FAR = 5.0
"""Ways longer than this look alike, in [m]."""


@dataclass(frozen=True)
class Navigate(Skill):
    """Reward (M3): 1 per meter of way nearer to the region. Stopping elsewhere ends it as a failure."""

    name = "navigate"
    base_speed = NAVIGATION_SPEED
    scan_reach = SCAN_RANGE
    failures = ("none", "stopped elsewhere")

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

    def observe(self, state: PrivilegedState, progress: Progress) -> FloatArray:
        """See `Skill.observe`."""
        aim = state.in_base(state.aim)
        far = np.sqrt(aim[:, 0] ** 2 + aim[:, 1] ** 2)
        safe = np.maximum(far, 1e-9)
        holding = (state.held >= 0).astype(np.float64)
        ahead = state.in_base(state.waypoint)
        columns = [aim[:, 0], aim[:, 1], far, aim[:, 0] / safe, aim[:, 1] / safe, holding]
        columns += [ahead[:, 0], ahead[:, 1], np.minimum(state.way, FAR)]
        return np.concatenate([*proprioception(state), np.stack(columns, axis=1), state.scan], axis=1)

    def terms(
        self, before: PrivilegedState, after: PrivilegedState, was: Progress, now: Progress
    ) -> Mapping[str, FloatArray]:
        """See `Skill.terms`."""
        return {"way": DISTANCE_REWARD * (counted_way(before) - counted_way(after))}

    def success(self, state: PrivilegedState, progress: Progress) -> BoolArray:
        """The robot stops within 0.1 m of the region, turned to within 0.25 rad of what it should face (M3)."""
        return state.stopped & _arrived(state)

    def failure(self, state: PrivilegedState, progress: Progress) -> IntArray:
        """It stopped elsewhere, or slid on."""
        return first_of(state.stopped & ~_arrived(state))

    def stop(self, state: PrivilegedState, progress: Progress) -> BoolArray:
        """It stopped, wherever that is."""
        return state.stopped

    def mask(self, actions: FloatArray, state: PrivilegedState) -> FloatArray:
        """Arm and gripper stay as they are; the map says that it has arrived where the action leaves that open."""
        masked = actions.copy()
        masked[:, ARM] = 0.0
        masked[:, GRIP] = 0.0
        masked[:, STOP] = np.where((actions[:, STOP] == 0.0) & _arrived(state), 1.0, actions[:, STOP])
        return masked


def _arrived(state: PrivilegedState) -> BoolArray:
    there: BoolArray = (state.way <= NEAR) & (np.abs(state.facing_error) <= FACING)
    return there


def counted_way(state: PrivilegedState) -> FloatArray:
    """The way to the region, as far as it counts: up to 0.05 m are none (M3). Shape (n,)."""
    return np.where(state.way <= 0.05, 0.0, state.way)
