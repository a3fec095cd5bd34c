"""The three tasks of the Home Assistant Benchmark: what is to be brought where, in which order, and how it is counted.

Contents:
    TASKS, get_task                             tidy_house, prepare_groceries, set_table
    HomeTask, TargetRule, PlacementRule         what a task is
    SkillStep, Stage, Predicate                 its skill sequence and its stages
    WorldFacts, NOTHING, SOMETHING_ELSE         what the conditions look at
    latch, latched_stages                       counting as the benchmark does
    Stabilizing, goal_stabilizing, handling_of  counting as the thesis does
    stabilizing_stages
"""

from perdure.home.benchmark.tasks.counting import (
    SETTLE_STEPS,
    Stabilizing,
    goal_stabilizing,
    handling_of,
    latch,
    latched_stages,
    stabilizing_stages,
)
from perdure.home.benchmark.tasks.facts import NOTHING, SOMETHING_ELSE, WorldFacts
from perdure.home.benchmark.tasks.predicates import AT, Predicate, predicate
from perdure.home.benchmark.tasks.prepare_groceries import PREPARE_GROCERIES
from perdure.home.benchmark.tasks.set_table import SET_TABLE
from perdure.home.benchmark.tasks.task import HomeTask, PlacementRule, SkillName, SkillStep, Stage, TargetRule
from perdure.home.benchmark.tasks.tidy_house import TIDY_HOUSE
from perdure.home.errors import HomeError

TASKS: dict[str, HomeTask] = {task.name: task for task in (TIDY_HOUSE, PREPARE_GROCERIES, SET_TABLE)}
"""The tasks by name."""


def get_task(name: str) -> HomeTask:
    """Return the task of that name; another name raises HomeError with the valid ones."""
    if name not in TASKS:
        raise HomeError(f"no task is named {name!r}; there are {', '.join(TASKS)}")
    return TASKS[name]


__all__ = [
    "AT",
    "NOTHING",
    "PREPARE_GROCERIES",
    "SETTLE_STEPS",
    "SET_TABLE",
    "SOMETHING_ELSE",
    "TASKS",
    "TIDY_HOUSE",
    "HomeTask",
    "PlacementRule",
    "Predicate",
    "SkillName",
    "SkillStep",
    "Stabilizing",
    "Stage",
    "TargetRule",
    "WorldFacts",
    "get_task",
    "goal_stabilizing",
    "handling_of",
    "latch",
    "latched_stages",
    "predicate",
    "stabilizing_stages",
]
