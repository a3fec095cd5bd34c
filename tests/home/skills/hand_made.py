"""PrivilegedState written by hand: robots at the room's origin, the gripper at rest and empty."""

from dataclasses import fields, replace

import numpy as np

from perdure.home.sim.robot import ROBOT
from perdure.home.sim.sensors import BEAMS, NEIGHBORS, SCAN_RANGE, PrivilegedState

REST = ROBOT.rest_position
BOWL, OTHER, DRAWER = 0, 4, 3
"""The skill_goal's object, another one, the skill_goal's link."""


def state(**changes):
    """One lane; vectors are given as lists."""
    numbers = {
        "base": np.zeros(3),
        "base_velocity": np.zeros(3),
        "arm": ROBOT.rest_arm,
        "arm_target": ROBOT.rest_arm,
        "gripper_in_base": REST,
        "gripper_rotation": np.eye(3),
        "gripper": REST,
        "gripper_velocity": np.zeros(3),
        "held": -1,
        "held_link": -1,
        "hold_error": 0.0,
        "target": BOWL,
        "object": np.array([2.0, 0.0, 0.8]),
        "object_up": np.array([0.0, 0.0, 1.0]),
        "goal": np.array([1.0, 0.0, 0.8]),
        "link": DRAWER,
        "handle": np.array([0.8, 0.0, 0.6]),
        "link_position": 0.0,
        "link_velocity": 0.0,
        "aim": np.array([1.0, 0.0, 0.8]),
        "way": 0.0,
        "facing_error": 0.0,
        "waypoint": np.zeros(3),
        "front": np.array([1.0, 0.0, 0.0]),
        "scan": np.full(BEAMS, SCAN_RANGE),
        "neighbors": np.zeros((NEIGHBORS, 3)),
        "neighbor_distance": np.inf,
        "handle_distance": np.inf,
        "stopped": False,
        "contact_force": 0.0,
        "diverged": False,
    }
    assert set(changes) <= set(numbers)
    return PrivilegedState(**{name: np.array([changes.get(name, value)]) for name, value in numbers.items()})


def change(one, **changes):
    """A lane with some of its numbers changed."""
    return replace(one, **{name: np.array([value]) for name, value in changes.items()})


def gripper_off(distance):
    """The gripper so far in front of its rest position; the base is at the origin."""
    there = REST + np.array([distance, 0.0, 0.0])
    return {"gripper_in_base": there, "gripper": there}


def course(skill, *moments):
    """Progress after these moments, one control step apart."""
    progress = skill.begin(moments[0])
    for moment in moments[1:]:
        progress = skill.advance(progress, moment)
    return progress


def succeeds(skill, *moments):
    return bool(skill.success(moments[-1], course(skill, *moments))[0])


def failure(skill, *moments):
    """The label of the failure at the last moment."""
    return skill.failure_labels[int(skill.failure(moments[-1], course(skill, *moments))[0])]


def step_reward(skill, *moments):
    """Reward and terms of the last step."""
    was = course(skill, *moments[:-1])
    now = skill.advance(was, moments[-1])
    total, terms = skill.reward(moments[-2], moments[-1], was, now)
    return float(total[0]), {name: float(value[0]) for name, value in terms.items()}


def random_state(n, seed):
    """n lanes of arbitrary numbers, for questions that do not depend on what they mean.

    An entry's numbers depend on its name, not on which other entries there are.
    """
    one = state()
    columns = {}
    for each in fields(PrivilegedState):
        rng = np.random.default_rng([seed, *each.name.encode()])
        value = getattr(one, each.name)
        shape = (n, *value.shape[1:])
        if value.dtype == bool:
            columns[each.name] = rng.random(shape) < 0.5
        elif value.dtype.kind == "i":
            columns[each.name] = rng.integers(-1, 5, shape)
        else:
            columns[each.name] = rng.normal(0.0, 1.0, shape)
    columns["contact_force"] = np.abs(60.0 * columns["contact_force"])
    return PrivilegedState(**columns)
