"""Parts that the observations of several skills share: what a robot senses of itself, and points around it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from perdure.home.sim.robot.data import ARM_JOINTS, BASE_RADIUS, REST_POSITION, ROLLS
from perdure.home.sim.world import BEAMS, SCAN_RANGE, PrivilegedState
from perdure.home.skills.skill import SECTOR_DEPTH, Element, Progress, rest_distance

FloatArray = NDArray[np.float64]


def proprioception(state: PrivilegedState) -> list[FloatArray]:
    """Arm, gripper and base as the robot's own encoders tell. 26 columns."""
    lag = state.arm_target - state.arm
    speed = state.base_velocity[:, [0, 2]]
    to_rest = np.asarray(REST_POSITION) - state.gripper_in_base
    rotation = unit(state.gripper_rotation)
    axes = [rotation[:, :, 0], rotation[:, :, 2]]
    return [wound(state.arm), lag, speed, to_rest, rest_distance(state)[:, None], *axes]


def unit(axes: FloatArray) -> FloatArray:
    """Components of unit vectors; rounding may have put one a last bit beyond 1."""
    return np.clip(axes, -1.0, 1.0)


def wound(arm: FloatArray) -> FloatArray:
    """Arm angles, those of joints without end brought into [-pi, pi)."""
    result = arm.copy()
    for column in ROLLS:
        result[:, column] = np.mod(result[:, column] + np.pi, 2.0 * np.pi) - np.pi
    return result


PROPRIOCEPTION: tuple[Element, ...] = (
    *(Element(f"{name}", f"angle of {name}", "rad", -np.pi, np.pi) for name in ARM_JOINTS),
    *(Element(f"{name}_lag", f"servo target minus angle of {name}", "rad") for name in ARM_JOINTS),
    Element("base_forward", "speed of the base forward", "m/s"),
    Element("base_turn", "turning speed of the base", "rad/s"),
    *(
        Element(f"to_rest_{axis}", f"from the gripper point to its rest position, base frame {axis}", "m")
        for axis in "xyz"
    ),
    Element("rest_distance", "d_ee^r: length of that", "m", 0.0),
    *(Element(f"gripper_forward_{axis}", f"gripper's x axis, base frame {axis}", "1", -1.0, 1.0) for axis in "xyz"),
    *(Element(f"gripper_up_{axis}", f"gripper's z axis, base frame {axis}", "1", -1.0, 1.0) for axis in "xyz"),
)


SCAN: tuple[Element, ...] = tuple(
    Element(f"scan_{k:02d}", f"range of beam {k} of {BEAMS}, from ahead to the left", "m", 0.0, SCAN_RANGE)
    for k in range(BEAMS)
)


SECTORS = BEAMS // 2
CLOSENESS: tuple[Element, ...] = tuple(
    Element(
        f"close_{k:02d}",
        f"closeness in sector {k} of {SECTORS}, counter-clockwise from ahead: 1 at the base's rim, 0 from 1 m on",
        "1",
        0.0,
        1.0,
    )
    for k in range(SECTORS)
)


def closeness(state: PrivilegedState) -> FloatArray:
    """1 where the base's rim touches something, 0 where nothing is within 1 m of it. Shape (n, SECTORS).

    A sector is 45 degrees wide, its neighbors overlap it by 15.
    """
    ranges = state.scan
    before, after = np.roll(ranges, 1, axis=1), np.roll(ranges, -1, axis=1)
    nearest = np.minimum(np.minimum(before, ranges), after)[:, ::2]
    felt: FloatArray = np.clip(1.0 - (nearest - BASE_RADIUS) / SECTOR_DEPTH, 0.0, 1.0)
    return felt


CONTACT_SCALE = 20.0
"""Contact forces are felt in multiples of it, in [N], by their logarithm (OURS)."""
REACHING: tuple[Element, ...] = (
    Element("contact", "log(1 + contact force / 20 N)", "1", 0.0),
    Element("force_sum", "share of the sum of forces at which the skill fails", "1", 0.0, 1.0),
    Element("front_x", "which way the furniture faces, base axes x", "1", -1.0, 1.0),
    Element("front_y", "which way the furniture faces, base axes y", "1", -1.0, 1.0),
)


def reaching(state: PrivilegedState, progress: Progress, force_limit: float) -> list[FloatArray]:
    """What reaching into furniture takes: how hard the arm pushes, and where the furniture is open. Shape (n, 4)."""
    contact = np.log1p(state.contact_force / CONTACT_SCALE)
    spent = np.minimum(progress.force_sum / force_limit, 1.0)
    return [contact[:, None], spent[:, None], facing(state, state.front)]


def facing(state: PrivilegedState, directions: FloatArray) -> FloatArray:
    """Horizontal unit vectors of the room along the base's x and y. Shape (n, 3) -> (n, 2)."""
    return unit(state.turned_to_base(directions)[:, :2])


def seen_from_gripper(state: PrivilegedState, points: FloatArray) -> FloatArray:
    """From the gripper point to points of the room, along the axes of the base. Shape (n, 3)."""
    return state.turned_to_base(points - state.gripper)


def point_elements(name: str, what: str) -> tuple[Element, ...]:
    """Six elements: a point relative to the gripper and in the base frame."""
    return (
        *(Element(f"{name}_from_gripper_{a}", f"from the gripper point to {what}, base axes {a}", "m") for a in "xyz"),
        *(Element(f"{name}_in_base_{a}", f"{what}, base frame {a}", "m") for a in "xyz"),
    )


def point(state: PrivilegedState, points: FloatArray) -> list[FloatArray]:
    """The columns of `point_elements`."""
    return [seen_from_gripper(state, points), state.in_base(points)]
