"""Write docs/home/skills.md from the skills' own declarations, as part of `make docs`."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields
from itertools import groupby

from perdure.home.sim.robot import ROBOT
from perdure.home.sim.scene import SceneOptions
from perdure.home.skills import SKILLS, Element, Skill, get_skill, learned_skills
from perdure.home.skills.registry import env_id
from perdure.home.skills.skill import FORCE_CAP, FORCE_COST, FORCE_MARGIN, PENALTY, SUCCESS_REWARD

HEAD = """\
# Skills as environments

What each skill's environment observes, what its actions do, what it rewards and when it ends, following M3 except where
"our choice" is written. Base frame: x forward, y left, z up from the floor. Rest: where the gripper carries objects.
Region: the floor cells from which the next skill can begin. A row for several numbers: the components of a vector, all
arm joints, or all sectors and beams k, in order. A failure ends the skill."""
_AXIS = re.compile(r", [xyz]$")


def page() -> str:
    """Return the whole page as Markdown."""
    return "\n\n".join([HEAD, *(_section(name, _longest(name)) for name in learned_skills())]) + "\n"


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
    if "delta" in [each.name for each in fields(SKILLS[name])]:
        return get_skill(name, delta=2)
    return get_skill(name)


def _section(name: str, skill: Skill) -> str:
    usual = get_skill(name)
    more = ""
    if skill.limit > usual.limit:
        more = f"; {len(skill.elements)} and {usual.limit} + `delta` for `delta` above 1"
    facts = f"`{env_id(name)}`: {len(usual.elements)} numbers observed, at most {usual.limit} steps{more}. "
    parts = [f"## {name}", f"{facts}Contact force: at most {skill.force_limit:g} N. Success: {skill.success_text}."]
    parts.append(_table(("observed", "meaning", "unit", "from", "to"), _elements(skill.elements)))
    parts.append(_table(("action, from -1 to 1", "effect"), _actions(skill)))
    parts.append(_table(("reward", "value"), reward_texts(skill).items()))
    return "\n\n".join([*parts, _table(("failure", "when"), skill.failures.items())])


def _elements(elements: Sequence[Element]) -> Iterable[tuple[str, ...]]:
    """Yield a row for each element; the components of a vector, and elements that are numbered, share one."""
    for (meaning, unit, low, high), group in groupby(enumerate(elements), lambda pair: _series(pair[1])):
        names = [f"{k} `{each.name}`" for k, each in group]
        yield " to ".join(dict.fromkeys((names[0], names[-1]))), meaning, unit, f"{low:g}", f"{high:g}"


def _series(element: Element) -> tuple[str, str, float, float]:
    """Return what elements that share a row have in common: the meaning has no axis, joint or number."""
    meaning = re.sub("|".join(ROBOT.arm_names), "each arm joint", element.meaning)
    meaning = re.sub(r"(sector|beam) \d+", r"\1 k", _AXIS.sub("", meaning))
    return meaning, element.unit, element.low, element.high


def _actions(skill: Skill) -> Iterable[tuple[str, str]]:
    base_speed = min(skill.base_speed, SceneOptions.base_speed)
    effects = [
        ("forward", f"speed of the base; 1 is {base_speed:g} m/s"),
        ("turn", f"turning speed to the left; 1 is {base_speed:g} rad/s"),
        *((joint, f"change of the servo target; 1 is {skill.arm_step:g} rad per step") for joint in ROBOT.arm_names),
        ("grip", skill.grip_text),
    ]
    return ((f"{k} `{effects[c][0]}`", effects[c][1]) for k, c in enumerate(skill.active_columns))


def _table(head: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> str:
    return "\n".join(f"|{'|'.join(line)}|" for line in (head, ("---",) * len(head), *rows))
