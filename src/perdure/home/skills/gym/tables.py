"""What a learner sees, does, earns and how it ends, written down from the skills themselves (`docs/home/skills.md`).

`python -c "from perdure.home.skills.gym.tables import page; print(page())" > docs/home/skills.md` writes the page.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from perdure.home.sim.robot.data import ARM_JOINTS
from perdure.home.skills import GOAL_RADIUS, Element, Skill, articulated, get_skill, navigate, pick, place
from perdure.home.skills.actions import used
from perdure.home.skills.gym.register import env_id
from perdure.home.skills.observation import PROPRIOCEPTION
from perdure.home.skills.skill import (
    FORCE_CAP,
    FORCE_COST,
    FORCE_MARGIN,
    HANDLE_LIMIT,
    HOLD_LIMIT,
    PENALTY,
    RETRACTED,
    SUCCESS_REWARD,
)
from perdure.home.skills.starts import STARTS

_EVERYWHERE: Mapping[str, str] = {
    "force": f"-{FORCE_COST:g} per newton by which the contact force rose (forces up to {FORCE_MARGIN:g} N do not "
    f"count), at most -{FORCE_CAP:g} per step",
    "failure": f"-{PENALTY:g} when a failure ends the skill",
    "success": f"+{SUCCESS_REWARD:g}",
}
_HANDLE: Mapping[str, str] = {
    "approach": f"{articulated.DISTANCE_REWARD:g} per meter nearer to the handle, until it is held for the first time",
    "grasp": f"+{articulated.GRASP_REWARD:g} when the handle is held for the first time",
    "move": f"{articulated.JOINT_REWARD:g} per meter or radian nearer to the wanted position while the handle is held",
    "release": f"+{articulated.RELEASE_REWARD:g} for letting go where it should be",
    "retract": f"{articulated.DISTANCE_REWARD:g} per meter nearer to rest after that",
}
REWARDS: Mapping[str, Mapping[str, str]] = {
    "pick": {
        "approach": f"{pick.DISTANCE_REWARD:g} per meter nearer to the object while the hand is empty",
        "grasp": f"+{pick.GRASP_REWARD:g} when the object is held for the first time",
        "retract": f"{pick.DISTANCE_REWARD:g} per meter nearer to rest while it is held",
    },
    "place": {
        "carry": f"{place.DISTANCE_REWARD:g} per meter nearer to the goal while it is held, up counted apart (OURS)",
        "release": f"+{place.RELEASE_REWARD:g} for the first release, if inside the goal region",
        "retract": f"{place.DISTANCE_REWARD:g} per meter nearer to rest after it",
    },
    "navigate": {"way": f"{navigate.DISTANCE_REWARD:g} per meter nearer to the region, the last 0.05 m not counted"},
    **dict.fromkeys(("open_drawer", "close_drawer", "open_fridge", "close_fridge"), _HANDLE),
}
"""Terms of the reward by skill, without those that all skills have."""
_JOINT: Mapping[str, str] = {
    "open_drawer": "the drawer is within 0.05 m of 0.45 m (at its stop it may be 5 mm beyond)",
    "close_drawer": "the drawer is within 0.05 m of 0",
    "open_fridge": "the door is at pi/2 - 0.15 rad or beyond",
    "close_fridge": "the door is within 0.15 rad of 0",
}
_SUCCESS: Mapping[str, str] = {
    "pick": f"the target is held and the gripper is within {RETRACTED:g} m of rest",
    "place": f"for `delta` steps on end the object is within {GOAL_RADIUS:g} m of its goal and not held, and the "
    f"gripper is within {RETRACTED:g} m of rest",
    "navigate": f"the robot stops, which it does where its map says that it has arrived, within {navigate.NEAR:g} m "
    f"of way of the region, turned to within {navigate.FACING:g} rad of what it should face",
    **{
        name: f"{text}, the hand is empty and the gripper is within {articulated.RETRACTED:g} m of rest"
        for name, text in _JOINT.items()
    },
}
FAILURES: Mapping[str, str] = {
    "wrong object": "the hand holds something other than the target",
    "dropped": "the target was held and is not any more",
    "wrong drop": "the first release is outside the goal region",
    "wrong grasp": "the hand holds something other than the handle",
    "let go early": "the handle was let go before drawer or door had ever been where it should be",
    "left the goal": "drawer or door was where it should be, was let go, and is there no more",
    "invalid grasp": f"what is held is over {HOLD_LIMIT:g} m (a handle: {HANDLE_LIMIT:g} m) from the gripper point",
    "excess force": "rises of the contact force add up to more than the skill's limit",
    "stopped elsewhere": "the robot stopped outside the region, or turned away from what it should face",
}
"""Every skill's failures."""


def page() -> str:
    """The whole page, in Markdown."""
    parts = [
        "# Skills as environments",
        "Written by `perdure.home.skills.gym.tables`; a test compares this page with the code. Axes: base frame x "
        "forward, y left, z up from the floor.",
        "## What all see first",
        _elements(PROPRIOCEPTION, 0),
        *(skill_section(_of(name)) for name in STARTS),
        "## Failures",
        _table(("failure", "when"), FAILURES.items()),
    ]
    return "\n\n".join(parts) + "\n"


def skill_section(skill: Skill) -> str:
    """One skill's part of the page."""
    common = len(PROPRIOCEPTION)
    limit = "" if np.isinf(skill.force_limit) else f" Excess force: rises that add up to {skill.force_limit:g} N."
    ends = ", ".join(skill.failures[1:]) or "none"
    return "\n\n".join(
        [
            f"## {skill.name}: `{env_id(skill.name)}`",
            f"Numbers: {_count(skill)}; 0 to {common - 1} are those above.",
            _elements(skill.elements[common:], common),
            _actions(skill),
            _table(("reward", "value"), reward_terms(skill).items()),
            f"Success: {_SUCCESS[skill.name]}. Failures: {ends}.{limit} Limit: {_limit(skill)}.",
        ]
    )


def reward_terms(skill: Skill) -> dict[str, str]:
    """The terms of a skill's reward and what each is worth."""
    return {**REWARDS[skill.name], **_slack(skill), **_EVERYWHERE}


def _of(name: str) -> Skill:
    """The skill with all the elements it can have."""
    return get_skill(name, delta=2) if name == "place" else get_skill(name)


def _count(skill: Skill) -> str:
    fewer = len(get_skill(skill.name).elements)
    return str(fewer) if fewer == len(skill.elements) else f"{fewer} (where `delta` is above 1: {len(skill.elements)})"


def _limit(skill: Skill) -> str:
    limit = get_skill(skill.name).limit
    return f"{limit} steps" + (f" ({limit} + `delta` where that is above 1)" if skill.limit > limit else "")


def _slack(skill: Skill) -> dict[str, str]:
    return {"slack": f"-{skill.slack:g} in every step" if skill.slack else "0"}


def _elements(elements: Iterable[Element], first: int) -> str:
    rows = [
        (f"{k} `{each.name}`", each.meaning, each.unit, f"{_number(each.low)} .. {_number(each.high)}")
        for k, each in enumerate(elements, start=first)
    ]
    return _table(("number", "meaning", "unit", "range"), rows)


def _actions(skill: Skill) -> str:
    speed, step = f"{skill.base_speed:g}", f"{skill.arm_step:g}"
    grip = {
        "pick": "above 0: grasp what is nearest, if that is the object; pick never lets go",
        "place": "below 0: let go; place never grasps",
    }.get(skill.name, "above 0: grasp what is nearest, below 0: let go")
    rows = [("0 `forward`", f"speed of the base, 1 is {speed} m/s"), ("1 `turn`", f"to the left, 1 is {speed} rad/s")]
    if len(used(skill)) > len(rows):
        rows += [
            (f"{k} `{joint}`", f"added to the servo's target, 1 is {step} rad")
            for k, joint in enumerate(ARM_JOINTS, len(rows))
        ]
        rows.append((f"{len(rows)} `grip`", grip))
    return _table(("action, from -1 to 1", "what it does"), rows)


def _table(head: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> str:
    lines = [head, ("---",) * len(head), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _number(value: float) -> str:
    if np.isinf(value):
        return "inf" if value > 0 else "-inf"
    return {np.pi: "pi", -np.pi: "-pi"}.get(value, f"{value:g}")
