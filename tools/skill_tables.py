"""Write docs/home/skills.md from the skills themselves: `python tools/skill_tables.py`. A test compares the two."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import fields
from itertools import groupby
from pathlib import Path

import numpy as np

from perdure.home.sim.robot.data import ARM_JOINTS
from perdure.home.skills import SKILLS, Element, Skill, get_skill, learned_skills
from perdure.home.skills.gym import env_id
from perdure.home.skills.observation import PROPRIOCEPTION
from perdure.home.skills.progress import FORCE_MARGIN
from perdure.home.skills.skill import FORCE_CAP, FORCE_COST, PENALTY, SUCCESS_REWARD

PAGE = Path(__file__).parents[1] / "docs" / "home" / "skills.md"
INTRODUCTION = """\
Written by `tools/skill_tables.py` from the skills' own declarations. The page lists the observation, the actions, the
reward and the terminations of each environment.

- **Observation**: the numbers of the table below, then those of the skill.
- **Frames**: base frame x forward, y left, z up from the floor. A vector is given along the axes of the base.
- **Rest**: the gripper's rest position in front of the robot, where it carries objects.
- **Region**: the floor cells from which the next skill can begin; navigation drives there.
- **OURS**: differs from M3 (hab-mobile-manipulation), whose definitions the skills otherwise follow.
- **Rows for several numbers**: the components of a vector, all arm joints, or all sectors and beams k, in order."""


def page() -> str:
    """Return the whole page as Markdown."""
    failures = {name: text for skill in map(get_skill, learned_skills()) for name, text in skill.failures.items()}
    parts = [
        "# Skills as environments",
        INTRODUCTION,
        "## Numbers that every skill observes",
        _elements(PROPRIOCEPTION.elements, 0),
        *(skill_section(name) for name in learned_skills()),
        "## Failures",
        _table(("failure", "when"), failures.items()),
    ]
    return "\n\n".join(parts) + "\n"


def skill_section(name: str) -> str:
    """Return the section of one skill."""
    usual, skill, common = get_skill(name), _longest(name), len(PROPRIOCEPTION.elements)
    rows = [
        ("success", skill.success_text),
        ("failures", ", ".join(skill.failures) or "none"),
        (
            "excess force",
            f"the increases of the contact force add up to more than {skill.force_limit:g} N"
            if np.isfinite(skill.force_limit)
            else "",
        ),
        ("step limit", _with_delta(usual.limit, skill.limit, f"{usual.limit} + `delta`")),
    ]
    size = _with_delta(len(usual.elements), len(skill.elements), str(len(skill.elements)))
    return "\n\n".join(
        [
            f"## {name}: `{env_id(name)}`",
            f"Size of the observation: {size}. Numbers 0 to {common - 1} are those above.",
            _elements(skill.elements[common:], common),
            _table(("action, from -1 to 1", "effect"), _actions(skill)),
            _table(("reward term", "value"), reward_texts(skill).items()),
            _table(("ending", "when"), [row for row in rows if row[1]]),
        ]
    )


def reward_texts(skill: Skill) -> Mapping[str, str]:
    """Return what each term of a skill's reward pays."""
    return {
        **skill.rewards,
        "slack": f"-{skill.slack:g} in every step" if skill.slack else "0",
        "force": f"-{FORCE_COST:g} per newton of increase in contact force, at most -{FORCE_CAP:g} per step; forces up "
        f"to {FORCE_MARGIN:g} N count as 0",
        "failure": f"-{PENALTY:g} when a failure ends the skill",
        "success": f"+{SUCCESS_REWARD:g}",
    }


def _longest(name: str) -> Skill:
    """Return the skill with all elements that it can have."""
    return get_skill(name, **({"delta": 2} if "delta" in (each.name for each in fields(SKILLS[name])) else {}))


def _with_delta(usual: int, lasting: int, text: str) -> str:
    return str(usual) if usual == lasting else f"{usual}; {text} for `delta` above 1"


def _elements(elements: Iterable[Element], first: int) -> str:
    """Return a row for each element; the components of a vector, and elements that are numbered, share one."""
    rows = []
    for _, each in groupby(enumerate(elements, start=first), lambda pair: _series(pair[1])):
        group = list(each)
        (k, one), (last, other) = group[0], group[-1]
        name, meaning = f"{k} `{one.name}`", one.meaning
        if len(group) > 1:
            name = f"{name} to {last} `{other.name}`"
            axes = ", ".join(element.name[-1] for _, element in group)
            meaning = f"{_general(one)}, {axes}" if one.name[-2:] in _AXES else _general(one)
        rows.append((name, meaning, one.unit, f"{_number(one.low)} .. {_number(one.high)}"))
    return _table(("number", "meaning", "unit", "range"), rows)


_AXES = ("_x", "_y", "_z")


def _series(element: Element) -> tuple[object, ...]:
    """Return what elements that share a row have in common."""
    return _general(element), element.unit, element.low, element.high


def _general(element: Element) -> str:
    """Return the meaning of an element without its axis, joint or number."""
    meaning = element.meaning
    for joint in ARM_JOINTS:
        meaning = meaning.replace(joint, "each arm joint, from the shoulder to the wrist")
    if element.name[-2:] in _AXES:
        return meaning.removesuffix(f", {element.name[-1]}")
    return re.sub(r"(sector|beam) \d+", r"\1 k", meaning)


def _actions(skill: Skill) -> list[tuple[str, str]]:
    speed = f"{skill.base_speed:g}"
    effects = [
        ("forward", f"speed of the base; 1 is {speed} m/s"),
        ("turn", f"turning speed to the left; 1 is {speed} rad/s"),
        *((joint, f"change of the servo target; 1 is {skill.arm_step:g} rad per step") for joint in ARM_JOINTS),
        ("grip", skill.grip_text),
    ]
    rows = [(f"{k} `{effects[c][0]}`", effects[c][1]) for k, c in enumerate(skill.active_columns)]
    groups = [list(each) for _, each in groupby(rows, lambda row: row[1])]
    return [(each[0][0] if len(each) == 1 else f"{each[0][0]} to {each[-1][0]}", each[0][1]) for each in groups]


def _table(head: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> str:
    lines = [head, ("---",) * len(head), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _number(value: float) -> str:
    if np.isinf(value):
        return "inf" if value > 0 else "-inf"
    return {np.pi: "pi", -np.pi: "-pi"}.get(value, f"{value:g}")


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
