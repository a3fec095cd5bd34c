"""Observation terms: blocks of an observation with their documentation, and those that several skills share."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from perdure.home.sim.arrays import FloatArray
from perdure.home.sim.robot.data import ARM_JOINTS, BASE_RADIUS, REST_POSITION, ROLLS
from perdure.home.sim.world import BEAMS, SCAN_RANGE, PrivilegedState
from perdure.home.sim.world.state import norm, wrap
from perdure.home.skills.progress import SkillProgress

SECTORS = BEAMS // 2
SECTOR_DEPTH = 1.0
"""Range of the closeness term in [m], measured from the base's rim (OURS)."""
CONTACT_SCALE = 20.0
"""Scale of the contact force in its logarithm in [N] (OURS)."""


@dataclass(frozen=True)
class Element:
    """The documentation of one number of an observation."""

    name: str
    meaning: str
    unit: str
    low: float = -np.inf
    high: float = np.inf


@dataclass(frozen=True)
class ObservationTerm:
    """A block of consecutive numbers of an observation."""

    elements: tuple[Element, ...]
    """One for each number."""
    read: Callable[[PrivilegedState, SkillProgress], list[FloatArray]]
    """Returns the values of n lanes as arrays of shape (n,) or (n, k), in the order of `elements`."""


def flag(name: str, meaning: str) -> Element:
    """Return an element that is 1 when something holds, else 0."""
    return Element(name, f"1 when {meaning}, else 0", "1", 0.0, 1.0)


def vector(name: str, meaning: str, axes: str = "xyz", unit: str = "m", bound: float = np.inf) -> tuple[Element, ...]:
    """Return one element for each component of a vector along the base's axes."""
    return tuple(Element(f"{name}_{axis}", f"{meaning}, {axis}", unit, -bound, bound) for axis in axes)


def point(name: str, what: str, read: Callable[[PrivilegedState], FloatArray]) -> ObservationTerm:
    """Return the term of a point of the room: relative to the gripper point, then in the base frame.

    `name` is the prefix of the six elements, `what` the point in words; `read` returns the points in the room, (n, 3).
    """
    elements = (
        *vector(f"{name}_from_gripper", f"vector from the gripper point to {what}"),
        *vector(f"{name}_in_base", f"position of {what} in the base frame"),
    )
    return ObservationTerm(elements, lambda state, _: _point(state, read(state)))


def reaching(force_limit: float) -> ObservationTerm:
    """Return the term for reaching into furniture: contact forces, and the side on which the furniture is open.

    `force_limit` is the sum of force increases in [N] that ends the skill.
    """
    elements = (
        Element("contact", "log(1 + contact force / 20 N)", "1", 0.0),
        Element("force_sum", "sum of force increases divided by the limit at which the skill fails", "1", 0.0, 1.0),
        *vector("front", "direction in which the furniture faces", "xy", "1", 1.0),
    )
    return ObservationTerm(
        elements,
        lambda state, progress: [
            np.log1p(state.contact_force / CONTACT_SCALE),
            np.minimum(progress.force_sum / force_limit, 1.0),
            facing(state, state.front),
        ],
    )


def facing(state: PrivilegedState, directions: FloatArray) -> FloatArray:
    """Return horizontal unit vectors of the room along the base's x and y axes. Shape (n, 3) -> (n, 2)."""
    return unit(state.turned_to_base(directions)[:, :2])


def unit(axes: FloatArray) -> FloatArray:
    """Return components of unit vectors clipped to [-1, 1]; rounding may exceed 1 by one bit."""
    return np.clip(axes, -1.0, 1.0)


def rest_distance(state: PrivilegedState) -> FloatArray:
    """Return d_ee^r, the distance of the gripper point from its rest position in [m]. Shape (n,)."""
    return norm(state.gripper_in_base - np.asarray(REST_POSITION))


def _point(state: PrivilegedState, points: FloatArray) -> list[FloatArray]:
    return [state.turned_to_base(points - state.gripper), state.in_base(points)]


def _proprioception(state: PrivilegedState, _: SkillProgress) -> list[FloatArray]:
    rotation = unit(state.gripper_rotation)
    return [
        _wrapped(state.arm),
        state.arm_target - state.arm,
        state.base_velocity[:, [0, 2]],
        np.asarray(REST_POSITION) - state.gripper_in_base,
        rest_distance(state),
        rotation[:, :, 0],
        rotation[:, :, 2],
    ]


def _wrapped(arm: FloatArray) -> FloatArray:
    """Return arm angles with those of unlimited joints in [-pi, pi)."""
    result = arm.copy()
    result[:, ROLLS] = wrap(result[:, ROLLS])
    return result


def _closeness(state: PrivilegedState, _: SkillProgress) -> list[FloatArray]:
    """Return the nearest of three beams for each sector: 45 degrees wide, 15 shared with each neighbor."""
    ranges = state.scan
    before, after = np.roll(ranges, 1, axis=1), np.roll(ranges, -1, axis=1)
    nearest = np.minimum(np.minimum(before, ranges), after)[:, ::2]
    return [np.clip(1.0 - (nearest - BASE_RADIUS) / SECTOR_DEPTH, 0.0, 1.0)]


PROPRIOCEPTION = ObservationTerm(
    (
        *(Element(name, f"angle of {name}", "rad", -np.pi, np.pi) for name in ARM_JOINTS),
        *(Element(f"{name}_lag", f"servo target minus angle of {name}", "rad") for name in ARM_JOINTS),
        Element("base_forward", "forward speed of the base", "m/s"),
        Element("base_turn", "turning speed of the base", "rad/s"),
        *vector("to_rest", "vector from the gripper point to its rest position, base frame"),
        Element("rest_distance", "d_ee^r: length of that vector", "m", 0.0),
        *vector("gripper_forward", "x axis of the gripper in the base frame", unit="1", bound=1.0),
        *vector("gripper_up", "z axis of the gripper in the base frame", unit="1", bound=1.0),
    ),
    _proprioception,
)
"""Arm, gripper and base as the robot's own encoders measure them: 26 numbers."""
CLOSENESS = ObservationTerm(
    tuple(
        Element(
            f"close_{k:02d}",
            f"closeness of obstacles in sector {k} of {SECTORS}, counter-clockwise from straight ahead: 1 at the "
            "base's rim, 0 from 1 m on",
            "1",
            0.0,
            1.0,
        )
        for k in range(SECTORS)
    ),
    _closeness,
)
SCAN = ObservationTerm(
    tuple(
        Element(f"scan_{k:02d}", f"range of beam {k} of {BEAMS}, counter-clockwise from straight ahead", "m", 0.0, high)
        for k, high in enumerate([SCAN_RANGE] * BEAMS)
    ),
    lambda state, _: [state.scan],
)
HOLDING = ObservationTerm((flag("holding", "something is held"),), lambda state, _: [(state.held >= 0).astype(float)])
