"""The three tasks of the Home Assistant Benchmark: what is brought where, in which order, and how it is counted.

`data/tasks.json` declares them. Conditions are those of M3 (hab-mobile-manipulation,
`habitat_extensions/tasks/rearrange/composite_sensors.py`):

| written | true when |
|---|---|
| `at(i)` | target i is within 0.15 m of its goal: positions only, in space, whatever its speed |
| `holding(i)` | the gripper holds target i |
| `not_holding()` | the gripper holds nothing, no handle either |
| `opened_drawer()` | the drawer of target 0 is out by 0.4 m or more |
| `closed_drawer()` | ... by 0.1 m or less |
| `opened_fridge()` | the fridge's upper door is open by 1.57 - 0.15 = 1.42 rad or more |
| `closed_fridge()` | ... by 0.15 rad or less |

*Latched*, as the benchmark counts: a stage is reached at the first step at which its conditions hold, if all earlier
stages are reached by then, and stays reached whatever happens later. A can that is inside its goal region while it
falls has been placed.

*Goal-stabilizing*, as the thesis counts: a placement counts if, once the plan has handled the object for the last time,
the object is in its goal region and out of the hand at every step, to the end of the episode and for a settling time
after it. So it counts at the end only.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from perdure.errors import PerdureError, lookup
from perdure.home.sim.arrays import BoolArray, FloatArray, IntArray
from perdure.schema import checked, read_json

SkillName = str
"""The name of any skill; the executor checks it when a plan runs (`perdure.home.skills.SKILLS`)."""


@dataclass(frozen=True)
class SkillStep:
    """One skill of a task's sequence."""

    skill: SkillName
    target: int
    """Number of the target it is about."""
    toward: SkillName | None = None
    """For `navigate`: the skill that follows, which decides where to go."""
    attempt: int = 1
    """Number of the attempt, from 1; of the skill that follows for `navigate`."""
    scripted: bool = False
    """Whether the scripted skill stands in for the policy."""


@dataclass(frozen=True)
class Stage:
    """A subgoal of a task, reached when all its conditions are met at one step and all earlier ones were reached."""

    name: str
    conditions: tuple[Predicate, ...]

    def met(self, facts: WorldFacts) -> BoolArray:
        """Return where all conditions are met, whatever happened before. Shape (*)."""
        return np.asarray(np.all([condition.holds(facts) for condition in self.conditions], axis=0))

    @property
    def placed(self) -> int | None:
        """The target whose placement this stage is, None for other stages."""
        kind, _, number = self.name.partition("_")
        return int(number) if kind == "place" else None


@dataclass(frozen=True)
class PlacementRule:
    """How one group of objects is drawn: which objects, on which receptacles, in how much of their middle."""

    objects: tuple[str, ...]
    receptacles: tuple[str, ...]
    ratio: Mapping[str, float] = field(default_factory=dict)
    """Share of a receptacle's length and width that is used, by receptacle name, 1 where not given."""


@dataclass(frozen=True)
class TargetRule:
    """How one target is drawn: where it starts and where it belongs."""

    start: PlacementRule
    goal: PlacementRule


@dataclass(frozen=True, eq=False)
class HomeTask:
    """A task of the Home Assistant Benchmark."""

    name: str
    targets: tuple[TargetRule, ...]
    clutter: tuple[tuple[int, PlacementRule], ...]
    """How many objects of which rule, beside the targets."""
    opened: Mapping[str, float]
    """Joint positions of doors at the start by link name; everything else is closed."""
    max_steps: int
    """Control steps an episode of the benchmark lasts."""
    conditions: Mapping[str, tuple[str, ...]]
    """Conditions of each stage, such as `at(1)`, by its name, in order."""
    sequence: tuple[SkillStep, ...] = ()
    """Skills in place of the planner's."""

    @cached_property
    def stages(self) -> tuple[Stage, ...]:
        """Its stages; PerdureError for a condition that there is not."""
        return tuple(Stage(name, tuple(map(predicate, texts))) for name, texts in self.conditions.items())


NOTHING = -1
"""`held` when the gripper holds nothing."""
SOMETHING_ELSE = -2
"""`held` when the gripper holds clutter or a handle."""


@dataclass(frozen=True)
class WorldFacts:
    """The state of a task in one world, or in many: the leading axes `*` may be lanes, steps, both or nothing."""

    object_positions: FloatArray
    """Middles of the target objects in the room in [m]. Shape (*, targets, 3)."""
    goal_positions: FloatArray
    """Where they belong in [m]. Shape (*, targets, 3) or (targets, 3)."""
    held: IntArray
    """Number of the target in the gripper, or NOTHING, or SOMETHING_ELSE. Shape (*)."""
    drawer: FloatArray
    """How far the drawer of target 0 is out in [m] (0 where the task has none). Shape (*)."""
    fridge: FloatArray
    """How far the fridge's upper door is open in [rad]. Shape (*)."""

    def __post_init__(self) -> None:
        """Raise PerdureError for shapes that do not match."""
        shapes = {each.name: np.shape(getattr(self, each.name)) for each in fields(self)}
        lead, targets = shapes["held"], shapes["object_positions"][-2:]
        for name, wanted in {"object_positions": lead + targets, "drawer": lead, "fridge": lead}.items():
            if shapes[name] != wanted:
                raise PerdureError(f"{name} has shape {shapes[name]}; with held of shape {lead} it must be {wanted}")
        goals = shapes["goal_positions"]
        if targets[-1:] != (3,) or goals not in (targets, lead + targets):
            raise PerdureError(f"goal_positions has shape {goals}; it must be {targets} or {lead + targets}")

    @property
    def targets(self) -> int:
        """Number of target objects."""
        return int(np.shape(self.object_positions)[-2])

    def __len__(self) -> int:
        """Length of the first leading axis."""
        return len(self.held)


AT = 0.15
"""Largest distance in [m] of an object that is at its goal."""
DRAWER_OPEN, DRAWER_CLOSED = 0.4, 0.1
FRIDGE_OPENED, FRIDGE_CLOSED = 1.57 - 0.15, 0.15


def at(facts: WorldFacts) -> BoolArray:
    """Return which targets are at their goals. Shape (*, targets)."""
    return np.asarray(np.linalg.norm(facts.object_positions - facts.goal_positions, axis=-1) <= AT)


PREDICATES: dict[str, Callable[[WorldFacts, Any], BoolArray]] = {
    "at": lambda facts, i: at(facts)[..., i],
    "holding": lambda facts, i: np.asarray(facts.held == i),
    "not_holding": lambda facts, _: np.asarray(facts.held == NOTHING),
    "opened_drawer": lambda facts, _: np.asarray(facts.drawer >= DRAWER_OPEN),
    "closed_drawer": lambda facts, _: np.asarray(facts.drawer <= DRAWER_CLOSED),
    "opened_fridge": lambda facts, _: np.asarray(facts.fridge >= FRIDGE_OPENED),
    "closed_fridge": lambda facts, _: np.asarray(facts.fridge <= FRIDGE_CLOSED),
}
"""All conditions; the first two are about a target."""


@dataclass(frozen=True)
class Predicate:
    """One condition, such as `at(1)`; made by `predicate`."""

    name: str
    target: int | None = None

    def __str__(self) -> str:
        return f"{self.name}({'' if self.target is None else self.target})"

    def holds(self, facts: WorldFacts) -> BoolArray:
        """Return where the condition is met. Shape (*)."""
        if self.target is not None and self.target >= facts.targets:
            raise PerdureError(f"{self} is about a target that is not there: the facts know {facts.targets} targets")
        return PREDICATES[self.name](facts, self.target)


def predicate(text: str) -> Predicate:
    """Read a condition such as `at(1)` or `not_holding()`; anything else raises PerdureError."""
    valid = [f"{name}(i)" if name in ("at", "holding") else f"{name}()" for name in PREDICATES]
    if "(i)" in text or re.sub(r"\(\d+\)", "(i)", text) not in valid:
        raise PerdureError(f"no condition reads {text!r}; there are {', '.join(valid)}")
    name, _, number = text.removesuffix(")").partition("(")
    return Predicate(name, int(number) if number else None)


def with_resets(*skills: tuple[SkillName, int]) -> tuple[SkillStep, ...]:
    """Return a skill sequence from (skill, target) pairs.

    `reset_arm` is added after every skill, and each `navigate` gets the name of the next skill.
    """
    steps: list[SkillStep] = []
    for k, (skill, target) in enumerate(skills):
        steps.append(SkillStep(skill, target, skills[k + 1][0] if skill == "navigate" else None))
        steps.append(SkillStep("reset_arm", target))
    return tuple(steps)


def _spelled_out(value: Any, groups: Mapping[str, Any]) -> Any:
    """Return a JSON value with the names of groups replaced by what they hold."""
    if isinstance(value, dict):
        return {name: _spelled_out(each, groups) for name, each in value.items()}
    if isinstance(value, list):
        return [_spelled_out(each, groups) for each in value]
    return groups.get(value, value)


_DATA = read_json((Path(__file__).parents[1] / "data" / "tasks.json").read_bytes())
_FOUND: tuple[HomeTask, ...] = checked(_spelled_out(_DATA["tasks"], _DATA["groups"]), tuple[HomeTask, ...])
TASKS = {task.name: task for task in _FOUND}
"""The tasks by name."""


def get_task(name: str) -> HomeTask:
    """Return the task of that name; another name raises PerdureError with the valid ones."""
    return lookup(TASKS, name, "task")


SETTLE_STEPS = 150
"""Control steps the world goes on after an episode: 5 s, the time the benchmark's generator gives objects to settle."""
