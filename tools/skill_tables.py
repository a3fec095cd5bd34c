"""Write docs/home/skills.md from the skills themselves: `python tools/skill_tables.py`. A test compares the two."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import fields
from itertools import groupby
from pathlib import Path

import numpy as np

from perdure.home.sim.robot import ARM_JOINTS
from perdure.home.skills import SKILLS, Element, Skill, get_skill, learned_skills
from perdure.home.skills.registry import env_id
from perdure.home.skills.skill import FORCE_CAP, FORCE_COST, FORCE_MARGIN, PENALTY, SUCCESS_REWARD

PAGE = Path(__file__).parents[1] / "docs" / "home" / "skills.md"
INTRODUCTION = """\
What each skill's environment observes, what its actions do, what it rewards and when it ends. Written by
`tools/skill_tables.py` from the skills' own declarations, which follow M3 except where "our choice" is written.

- **Base frame**: x forward, y left, z up from the floor. **Rest**: where the gripper carries objects.
- **Region**: the floor cells from which the next skill can begin; navigation drives there.
- **Rows for several numbers**: the components of a vector, all arm joints, or all sectors and beams k, in order."""
_AXES = ("_x", "_y", "_z")


def page() -> str:
    """Return the whole page as Markdown."""
    skills = {name: _longest(name) for name in learned_skills()}
    head = ("skill", "environment", "numbers observed", "step limit", "force limit", "success")
    parts = [
        "# Skills as environments",
        INTRODUCTION,
        _table(head, map(_summary, skills)),
        "## Observations",
        _shared(("number", "meaning", "unit", "range"), skills, lambda skill: _elements(skill.elements)),
        "## Actions, from -1 to 1",
        _shared(("action", "effect"), skills, _actions),
        "## Reward",
        _shared(("term", "value"), skills, lambda skill: reward_texts(skill).items()),
        "## Failures",
        "A failure ends the skill.",
        _table(("failure", "when", "skills"), _failures(skills)),
    ]
    return "\n\n".join(parts) + "\n"


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


def _summary(name: str) -> tuple[str, ...]:
    usual, longest = get_skill(name), _longest(name)
    size = _with_delta(len(usual.elements), len(longest.elements), str(len(longest.elements)))
    force = f"{usual.force_limit:g} N" if np.isfinite(usual.force_limit) else "none"
    limit = _with_delta(usual.limit, longest.limit, f"{usual.limit} + `delta`")
    return name, f"`{env_id(name)}`", size, limit, force, usual.success_text


def _failures(skills: Mapping[str, Skill]) -> Iterable[tuple[str, ...]]:
    texts = {name: text for skill in skills.values() for name, text in skill.failures.items()}
    for name, text in texts.items():
        yield name, text, _names(skills, [each for each, skill in skills.items() if name in skill.failures])


def _longest(name: str) -> Skill:
    """Return the skill with all elements that it can have."""
    return get_skill(name, **({"delta": 2} if "delta" in (each.name for each in fields(SKILLS[name])) else {}))


def _with_delta(usual: int, lasting: int, text: str) -> str:
    return str(usual) if usual == lasting else f"{usual}; {text} for `delta` above 1"


def _shared(
    head: tuple[str, ...], skills: Mapping[str, Skill], rows: Callable[[Skill], Iterable[tuple[str, ...]]]
) -> str:
    """Return one table: a row that several skills share appears once, with their names."""
    owners: dict[tuple[str, ...], list[str]] = {}
    for name, skill in skills.items():
        for line in rows(skill):
            owners.setdefault(line, []).append(name)
    return _table((*head, "skills"), ((*line, _names(skills, names)) for line, names in owners.items()))


def _names(every: Iterable[str], some: Sequence[str]) -> str:
    """Return the names of some skills, or briefly of all or all but one or two."""
    missing = [name for name in every if name not in some]
    if not missing:
        return "all"
    return f"all but {', '.join(missing)}" if len(missing) <= 2 else ", ".join(some)


def _elements(elements: Sequence[Element]) -> list[tuple[str, ...]]:
    """Return a row for each element; the components of a vector, and elements that are numbered, share one."""
    rows = []
    for _, each in groupby(enumerate(elements), lambda pair: _series(pair[1])):
        group = list(each)
        (k, one), (last, other) = group[0], group[-1]
        name, meaning = f"{k} `{one.name}`", one.meaning
        if len(group) > 1:
            name, meaning = f"{k} `{one.name}` to {last} `{other.name}`", _general(one)
        rows.append((name, meaning, one.unit, _range(one.low, one.high)))
    return rows


def _series(element: Element) -> tuple[object, ...]:
    """Return what elements that share a row have in common."""
    return _general(element), element.unit, element.low, element.high


def _general(element: Element) -> str:
    """Return the meaning of an element without its axis, joint or number."""
    meaning = element.meaning
    for joint in ARM_JOINTS:
        meaning = meaning.replace(joint, "each arm joint")
    if element.name[-2:] in _AXES:
        return meaning.removesuffix(f", {element.name[-1]}")
    return re.sub(r"(sector|beam) \d+", r"\1 k", meaning)


def _actions(skill: Skill) -> list[tuple[str, ...]]:
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
    return "\n".join(f"|{'|'.join(line)}|" for line in (head, ("---",) * len(head), *rows))


def _range(low: float, high: float) -> str:
    if np.isinf(low):
        return "any"
    return f"from {_number(low)}" if np.isinf(high) else f"{_number(low)} to {_number(high)}"


def _number(value: float) -> str:
    return {np.pi: "pi", -np.pi: "-pi"}.get(value, f"{value:g}")


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
