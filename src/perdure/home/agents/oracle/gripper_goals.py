"""Candidate gripper poses for picking, placing and holding a handle."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from perdure.home.agents.oracle.reach_plan import GripperGoal
from perdure.home.sim.arrays import FloatArray

STANDOFFS = (0.11, 0.08, 0.05)
"""Distances from the gripper point to the middle of the object to be grasped in [m]: within the magic grasp's reach."""
NEIGHBOR_GAP = 0.02
"""Margin in [m] by which other objects and handles must be farther from the gripper point than the target."""
SLOPES = (np.radians(60.0), np.radians(90.0), np.radians(35.0), np.radians(0.0))
"""Downward angles of the gripper on open surfaces, in [rad]."""
INSIDE_SLOPES = (np.radians(15.0), np.radians(0.0), np.radians(35.0), np.radians(55.0))
"""The same in a fridge."""
LIFT, HIGH_LIFT = 0.08, 0.25
"""Heights of the pre-grasp point above the grasp point in [m]."""
ASIDE = 0.11
"""Distance beside or above an object from which it is grasped when another one is in front of it, in [m]."""
BACK = 0.4
"""Distance behind the standing place at which the arm is raised in front of a fridge, in [m]."""
TURNS = (0.0, 0.5, -0.5)
"""Turns of the approach about the vertical, in [rad]."""
INSIDE_TURNS = (0.0, 0.4, -0.4, 0.8, -0.8)
"""The same in a fridge, where one object may stand in front of another."""


def pick_gripper_goals(point: FloatArray, origin: FloatArray, neighbors: FloatArray, inside: bool) -> list[GripperGoal]:
    """Return poses in which the magic grasp takes the object at a point (3,) and nothing else.

    The robot comes from `origin` on the floor, shape (2,). `neighbors` are the middles of other objects, and handles,
    shape (k, 3). Inside a fridge the gripper comes from the front, not from above.
    """
    gripper_goals = []
    for slope in INSIDE_SLOPES if inside else SLOPES:
        for turn in INSIDE_TURNS if inside else TURNS:
            approach = _direction(point, origin, slope, turn)
            for standoff in STANDOFFS:
                spot = point - standoff * approach
                if len(neighbors) and np.linalg.norm(neighbors - spot, axis=1).min() < standoff + NEIGHBOR_GAP:
                    continue
                before = np.array([0.0, 0.0, 0.0 if inside else LIFT])
                gripper_goals.append(GripperGoal(spot, approach, False, before, BACK if inside else 0.0))
    return gripper_goals


def goals_aside(point: FloatArray, origin: FloatArray, neighbors: FloatArray) -> list[GripperGoal]:
    """Return poses beside and above an object behind another one in a fridge; arguments as `pick_gripper_goals`."""
    gripper_goals = []
    for slope in INSIDE_SLOPES[:3]:
        for turn in INSIDE_TURNS:
            approach = _direction(point, origin, slope, turn)
            left = np.array([-approach[1], approach[0], 0.0]) / np.hypot(approach[0], approach[1])
            for across, up in ((1.0, 0.0), (-1.0, 0.0), (0.7, 0.7), (-0.7, 0.7), (0.0, 1.0)):
                spot = point + ASIDE * (across * left + np.array([0.0, 0.0, up]))
                if len(neighbors) and np.linalg.norm(neighbors - spot, axis=1).min() < ASIDE + NEIGHBOR_GAP:
                    continue
                gripper_goals.append(GripperGoal(spot, approach, False, np.zeros(3), BACK))
    return gripper_goals


def handle_grabs(point: FloatArray, origin: FloatArray, sides: Sequence[FloatArray]) -> list[GripperGoal]:
    """Return poses in which the magic grasp takes a handle at a point (3,), approached from a place on the floor (2,).

    The gripper waits in one of the directions `sides` from the handle, each of length 1 and shape (3,).
    """
    gripper_goals = []
    for side in sides:
        for slope in (np.radians(20.0), np.radians(50.0), np.radians(0.0)):
            for turn in TURNS:
                approach = _direction(point, origin, slope, turn)
                gripper_goals.append(GripperGoal(point + 0.09 * side, approach, False, 0.05 * side))
    return gripper_goals


def place_gripper_goals(point: FloatArray, origin: FloatArray, height: float, inside: bool) -> list[GripperGoal]:
    """Return level poses that hold the object upright, `height` in [m] above the goal of its middle, shape (3,).

    The robot comes from `origin` on the floor, shape (2,). `inside`: whether the goal is in a fridge.
    """
    up = np.array([0.0, 0.0, 1.0])
    gripper_goals = []
    for turn in (0.0, 0.25, -0.25, 0.5, -0.5, 0.8, -0.8):
        approach = _direction(point, origin, 0.0, turn)
        for back in (BACK, 0.6) if inside else (0.0, BACK):
            for more in (0.0, 0.03) if inside else (0.0,):
                spot = point + (height + more) * up
                for lift in (0.02,) if inside else (LIFT, HIGH_LIFT):
                    gripper_goals.append(GripperGoal(spot, approach, True, lift * up, back))
    return gripper_goals


def _direction(point: FloatArray, origin: FloatArray, slope: float, turn: float) -> FloatArray:
    heading = np.arctan2(point[1] - origin[1], point[0] - origin[0]) + turn
    return np.array([np.cos(heading) * np.cos(slope), np.sin(heading) * np.cos(slope), -np.sin(slope)])
