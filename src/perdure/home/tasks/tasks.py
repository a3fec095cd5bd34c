"""The tasks of the Home Assistant Benchmark: what is brought where, in which order, and how it is counted.

`data/tasks.json` declares them. Conditions are those of M3 (hab-mobile-manipulation,
`habitat_extensions/tasks/rearrange/composite_sensors.py`):

| written | true when |
|---|---|
| `at(i)` | target i is within 0.15 m of its goal: positions only, in space, whatever its speed |
| `holding(i)` | the gripper holds target i |
| `not_holding()` | the gripper holds nothing, no handle either |
| `opened(c)` | the container c, such as `fridge`, is open by `opened` of its row in `data/furniture.json` or more |
| `closed(c)` | ... by `closed` of that row or less |

Of several drawers the one counts in which a target of the episode starts or ends (`Episode.container_links`).

*Latched*, as the benchmark counts: a stage is reached at the first step at which its conditions hold, if all earlier
stages are reached by then, and stays reached whatever happens later. A can that is inside its goal region while it
falls has been placed.

*Goal-stabilizing*, as the thesis counts: a placement counts if, once the plan has handled the object for the last time,
the object is in its goal region and out of the hand at every step, to the end of the episode and for a settling time
after it. So it counts at the end only.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Any

import numpy as np

from perdure.errors import PerdureError, lookup
from perdure.home.sim.arrays import BoolArray, FloatArray, IntArray
from perdure.home.sim.pieces import CONTAINERS
from perdure.schema import checked, read_json

SkillName = str
"""The name of any skill; the executor checks it when a plan runs (`perdure.home.skills.SKILLS`)."""


class Verb(StrEnum):
    """What a skill does."""

    NAVIGATE = "navigate"
    PICK = "pick"
    PLACE = "place"
    OPEN = "open"
    CLOSE = "close"
    RESET_ARM = "reset_arm"


PAST: Mapping[str, str] = {Verb.PICK: "picked", Verb.PLACE: "placed", Verb.OPEN: "opened", Verb.CLOSE: "closed"}
"""Past participle of each verb that a stage may have; of open and close also the condition that they bring about."""
SKILL_VERBS: Mapping[SkillName, Verb] = {
    **{verb.value: verb for verb in (Verb.NAVIGATE, Verb.PICK, Verb.PLACE, Verb.RESET_ARM)},
    **{container.open_skill: Verb.OPEN for container in CONTAINERS.values()},
    **{container.close_skill: Verb.CLOSE for container in CONTAINERS.values()},
}
"""What each skill does."""
SKILL_CONTAINERS: Mapping[SkillName, str] = {
    skill: name for name, each in CONTAINERS.items() for skill in (each.open_skill, each.close_skill)
}
"""The container that a skill opens or closes."""


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

    verb: Verb
    """One of `PAST`."""
    target: int
    """Number of the target it is about."""
    conditions: tuple[Predicate, ...]

    def __post_init__(self) -> None:
        """Raise PerdureError for a verb that is no stage."""
        lookup(PAST, self.verb, "verb of a stage")

    @property
    def name(self) -> str:
        """In tables, such as `place_1`."""
        return f"{self.verb}_{self.target}"

    def met(self, facts: WorldFacts) -> BoolArray:
        """Return where all conditions are met, whatever happened before. Shape (*)."""
        return np.asarray(np.all([condition.holds(facts) for condition in self.conditions], axis=0))

    @property
    def placed(self) -> int | None:
        """The target whose placement this stage is, None for other stages."""
        return self.target if self.verb == Verb.PLACE else None


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
    stages: tuple[Stage, ...]
    """In order."""
    sequence: tuple[SkillStep, ...] = ()
    """Skills in place of the planner's."""


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
    containers: Mapping[str, FloatArray]
    """How far each container is open in [m] or [rad], by name; 0 where the task has none. Shape (*) each."""

    def __post_init__(self) -> None:
        """Raise PerdureError for an unknown container and for shapes that do not match."""
        lead = np.shape(self.held)
        objects = np.shape(self.object_positions)
        goals = np.shape(self.goal_positions)
        targets = objects[-2:]
        shapes = {"object_positions": (objects, lead + targets)}
        for name, position in self.containers.items():
            lookup(CONTAINERS, name, "container")
            shapes[name] = (np.shape(position), lead)
        for name, (shape, wanted) in shapes.items():
            if shape != wanted:
                raise PerdureError(f"{name} has shape {shape}; with held of shape {lead} it must be {wanted}")
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


def at(facts: WorldFacts) -> BoolArray:
    """Return which targets are at their goals. Shape (*, targets)."""
    return np.asarray(np.linalg.norm(facts.object_positions - facts.goal_positions, axis=-1) <= AT)


def container_position(facts: WorldFacts, name: str) -> FloatArray:
    """Return how far a container is open; PerdureError if the facts do not say it. Shape (*)."""
    return lookup(facts.containers, name, "container in these facts")


PREDICATES: dict[str, Callable[[WorldFacts, Any], BoolArray]] = {
    "at": lambda facts, target: at(facts)[..., target],
    "holding": lambda facts, target: np.asarray(facts.held == target),
    "not_holding": lambda facts, _: np.asarray(facts.held == NOTHING),
    "opened": lambda facts, name: np.asarray(container_position(facts, name) >= CONTAINERS[name].opened),
    "closed": lambda facts, name: np.asarray(container_position(facts, name) <= CONTAINERS[name].closed),
}
"""All conditions: of facts and what the condition is about, a target, a container or nothing."""
ABOUT_TARGETS = ("at", "holding")
ABOUT_CONTAINERS = ("opened", "closed")


@dataclass(frozen=True)
class Predicate:
    """One condition, such as `at(1)` or `opened(fridge)`.

    Raises:
        PerdureError: If there is no such condition, or it is about something else.
    """

    name: str
    target: int | None = None
    """For `at` and `holding`."""
    container: str | None = None
    """For `opened` and `closed`."""

    def __post_init__(self) -> None:
        lookup(PREDICATES, self.name, "condition")
        if (self.target is not None) != (self.name in ABOUT_TARGETS):
            raise PerdureError(f"{self} must name a target: {', '.join(ABOUT_TARGETS)} do, no other condition does")
        if (self.container is not None) != (self.name in ABOUT_CONTAINERS):
            wanted = ", ".join(ABOUT_CONTAINERS)
            raise PerdureError(f"{self} must name a container: {wanted} do, no other condition does")
        if self.container is not None:
            lookup(CONTAINERS, self.container, "container")

    def __str__(self) -> str:
        about = [str(each) for each in (self.target, self.container) if each is not None]
        return f"{self.name}({', '.join(about)})"

    def holds(self, facts: WorldFacts) -> BoolArray:
        """Return where the condition is met. Shape (*)."""
        if self.target is not None and self.target >= facts.targets:
            raise PerdureError(f"{self} is about a target that is not there: the facts know {facts.targets} targets")
        about = self.container if self.target is None else self.target
        return PREDICATES[self.name](facts, about)


def with_resets(*skills: tuple[SkillName, int]) -> tuple[SkillStep, ...]:
    """Return a skill sequence from (skill, target) pairs.

    `reset_arm` is added after every skill, and each `navigate` gets the name of the next skill.
    """
    steps: list[SkillStep] = []
    for k, (skill, target) in enumerate(skills):
        toward = skills[k + 1][0] if skill == Verb.NAVIGATE else None
        steps.append(SkillStep(skill, target, toward))
        steps.append(SkillStep(Verb.RESET_ARM.value, target))
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
"""The tasks by name. The seed of a task's episodes depends on its position: a new task goes to the end."""
STAGES = {stage.name: stage for task in _FOUND for stage in task.stages}
"""A stage of each name that tables have; only verb and target of it are the same in every task."""


def get_task(name: str) -> HomeTask:
    """Return the task of that name; another name raises PerdureError with the valid ones."""
    return lookup(TASKS, name, "task")


SETTLE_STEPS = 150
"""Control steps the world goes on after an episode: 5 s, the time the benchmark's generator gives objects to settle."""
