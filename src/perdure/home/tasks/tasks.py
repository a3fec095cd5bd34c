"""The three tasks of the Home Assistant Benchmark: what is brought where, in which order, and how it is counted.

As in M3 (hab-mobile-manipulation, `habitat_extensions/tasks/rearrange/composite_sensors.py`):

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
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np

from perdure.errors import PerdureError, lookup
from perdure.home.sim.arrays import BoolArray, FloatArray, IntArray

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
    stages: tuple[Stage, ...]
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


def pick_and_place_stages(targets: int) -> tuple[Stage, ...]:
    """pick_i: holding target i, all earlier ones at their goals. place_i: empty hand, targets 0 to i at their goals."""
    conditions: dict[str, list[str]] = {}
    for target in range(targets):
        earlier = [f"at({k})" for k in range(target)]
        conditions[f"pick_{target}"] = [f"holding({target})", *earlier]
        conditions[f"place_{target}"] = ["not_holding()", *earlier, f"at({target})"]
    return make_stages(conditions)


PANTRY = (
    "002_master_chef_can",
    "003_cracker_box",
    "004_sugar_box",
    "005_tomato_soup_can",
    "007_tuna_fish_can",
    "008_pudding_box",
    "009_gelatin_box",
    "010_potted_meat_can",
    "024_bowl",
)
"""The nine objects of TidyHouse, PrepareGroceries and all clutter."""
CHAIR = "receptacle_aabb_Chr1_Top1_frl_apartment_chair_01"
TABLE_1 = "receptacle_aabb_Tbl1_Top1_frl_apartment_table_01"
TABLE_2 = "receptacle_aabb_Tbl2_Top1_frl_apartment_table_02"
TV_STAND = "receptacle_aabb_TvStnd1_Top1_frl_apartment_tvstand"
COUNTER_RIGHT = "receptacle_aabb_counter_right_kitchen_counter"
COUNTER_LEFT = "receptacle_aabb_counter_left_kitchen_counter"
SOFA = "receptacle_aabb_Sofa_frl_apartment_sofa"
FRIDGE_MIDDLE = "receptacle_aabb_middle_topfrl_apartment_refrigerator"
FRIDGE_TOP = "receptacle_aabb_topfrl_apartment_refrigerator"
DRAWERS = (
    "receptacle_aabb_drawer_left_top_frl_apartment_kitchen_counter",
    "receptacle_aabb_drawer_middle_top_frl_apartment_kitchen_counter",
    "receptacle_aabb_drawer_right_top_frl_apartment_kitchen_counter",
)
OPEN_SURFACES = (CHAIR, TABLE_1, TABLE_2, TV_STAND, COUNTER_RIGHT, COUNTER_LEFT, SOFA)
"""M3 leaves the sink out, which the original benchmark had."""
CLUTTERED = (*OPEN_SURFACES, FRIDGE_TOP)
MIDDLE_HALF = {FRIDGE_MIDDLE: 0.5}
"""Targets stand in the middle half of the middle shelf's length and width."""
_FRIDGE = PlacementRule(PANTRY, (FRIDGE_MIDDLE,), MIDDLE_HALF)
_COUNTER = PlacementRule(PANTRY, (COUNTER_RIGHT, COUNTER_LEFT))
PREPARE_GROCERIES = HomeTask(
    name="prepare_groceries",
    targets=(TargetRule(_FRIDGE, _COUNTER), TargetRule(_FRIDGE, _COUNTER), TargetRule(_COUNTER, _FRIDGE)),
    clutter=((21, PlacementRule(PANTRY, CLUTTERED)), (1, PlacementRule(PANTRY, (FRIDGE_MIDDLE,)))),
    opened={"top_door": 2.356},
    max_steps=4000,
    stages=pick_and_place_stages(3),
)
"""M3: 3 targets and 22 other objects, the fridge stands open at 2.356 rad, 4000 steps, stages pick_0 to place_2."""
_TABLES = (TABLE_1, TABLE_2)
_BOWL, _APPLE = ("024_bowl",), ("013_apple",)
SET_TABLE = HomeTask(
    name="set_table",
    targets=(
        TargetRule(PlacementRule(_BOWL, DRAWERS), PlacementRule(_BOWL, _TABLES)),
        TargetRule(PlacementRule(_APPLE, (FRIDGE_MIDDLE,), MIDDLE_HALF), PlacementRule(_APPLE, _TABLES)),
    ),
    clutter=((21, PlacementRule(PANTRY, CLUTTERED)), (2, PlacementRule(PANTRY, (FRIDGE_MIDDLE,)))),
    opened={},
    max_steps=4500,
    stages=make_stages(
        {
            "open_0": ["opened_drawer()"],
            "pick_0": ["holding(0)"],
            "place_0": ["not_holding()", "at(0)"],
            "close_0": ["closed_drawer()", "at(0)"],
            "open_1": ["closed_drawer()", "at(0)", "opened_fridge()"],
            "pick_1": ["closed_drawer()", "at(0)", "opened_fridge()", "holding(1)"],
            "place_1": ["closed_drawer()", "at(0)", "not_holding()", "at(1)"],
            "close_1": ["closed_drawer()", "at(0)", "closed_fridge()", "at(1)"],
        }
    ),
)
"""M3: 2 targets and 23 other objects, 4500 steps."""
_ANYWHERE = PlacementRule(PANTRY, OPEN_SURFACES)
TIDY_HOUSE = HomeTask(
    name="tidy_house",
    targets=(TargetRule(_ANYWHERE, _ANYWHERE),) * 5,
    clutter=((20, _ANYWHERE),),
    opened={},
    max_steps=5000,
    stages=pick_and_place_stages(5),
)
"""M3: 25 objects of which 5 are targets, nothing is opened, 5000 steps, stages pick_0, place_0, ..., place_4."""
TASKS: dict[str, HomeTask] = {task.name: task for task in (TIDY_HOUSE, PREPARE_GROCERIES, SET_TABLE)}
"""The tasks by name."""


def get_task(name: str) -> HomeTask:
    """Return the task of that name; another name raises PerdureError with the valid ones."""
    return lookup(TASKS, name, "task")


SETTLE_STEPS = 150
"""Control steps the world goes on after an episode: 5 s, the time the benchmark's generator gives objects to settle."""
