"""What a task of the benchmark is: which objects go where, the order of the skills, the stages and their conditions."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from perdure.home.benchmark.tasks.facts import WorldFacts
from perdure.home.benchmark.tasks.predicates import Predicate, predicate
from perdure.home.errors import HomeError
from perdure.home.sim.arrays import BoolArray

BenchmarkSkill = Literal[
    "navigate", "pick", "place", "open_drawer", "close_drawer", "open_fridge", "close_fridge", "reset_arm"
]
"""The skills of the benchmark's own tasks."""
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


@dataclass(frozen=True)
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
    skills: tuple[SkillStep, ...]
    stages: tuple[Stage, ...]

    def stage(self, name: str) -> Stage:
        """Return the stage of that name."""
        table = {stage.name: stage for stage in self.stages}
        if name not in table:
            raise HomeError(f"{self.name} has no stage {name!r}; it has {', '.join(table)}")
        return table[name]


def make_stages(conditions: Mapping[str, Iterable[str]]) -> tuple[Stage, ...]:
    """Return stages from their names and their conditions as text, in order."""
    return tuple(Stage(name, tuple(predicate(text) for text in texts)) for name, texts in conditions.items())


def with_resets(*skills: tuple[SkillName, int]) -> tuple[SkillStep, ...]:
    """Return a skill sequence from (skill, target) pairs.

    `reset_arm` is added after every skill, and each `navigate` gets the name of the next skill.
    """
    steps: list[SkillStep] = []
    for k, (skill, target) in enumerate(skills):
        steps.append(SkillStep(skill, target, skills[k + 1][0] if skill == "navigate" else None))
        steps.append(SkillStep("reset_arm", target))
    return tuple(steps)


def pick_and_place_skills(targets: int) -> tuple[SkillStep, ...]:
    """Navigate, pick, navigate, place for each target in turn, as in TidyHouse and PrepareGroceries."""
    order: tuple[BenchmarkSkill, ...] = ("navigate", "pick", "navigate", "place")
    return with_resets(*((skill, target) for target in range(targets) for skill in order))


def pick_and_place_stages(targets: int) -> tuple[Stage, ...]:
    """pick_i: holding target i, all earlier ones at their goals. place_i: empty hand, targets 0 to i at their goals."""
    conditions: dict[str, list[str]] = {}
    for target in range(targets):
        earlier = [f"at({k})" for k in range(target)]
        conditions[f"pick_{target}"] = [f"holding({target})", *earlier]
        conditions[f"place_{target}"] = ["not_holding()", *earlier, f"at({target})"]
    return make_stages(conditions)
