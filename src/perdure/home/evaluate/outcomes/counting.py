"""Stages and placements from a log: the rules of `perdure.home.benchmark.tasks`, applied to the events alone.

Between two events nothing changes that a condition looks at, so it is enough to look at the steps of the events, at the
first and the last step of every run, and at the first and the last step of the settling time.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import TypeVar
from weakref import WeakKeyDictionary

import numpy as np

from perdure.home.benchmark.tasks import Predicate, WorldFacts, goal_stabilizing, stabilizing_stages
from perdure.home.evaluate.log import EpisodeLog
from perdure.home.sim.arrays import IntArray

NEVER = -1
"""In place of a step that never came."""
_OUTSIDE = 1.0
"""Distance from the goal in [m] in the facts of an object that an event reports outside its goal."""


_Counted = TypeVar("_Counted")


def _once(count: Callable[[EpisodeLog], _Counted]) -> Callable[[EpisodeLog], _Counted]:
    """Return a cached version of a function of a log; the cache lives as long as the log."""
    known: WeakKeyDictionary[EpisodeLog, _Counted] = WeakKeyDictionary()

    @wraps(count)
    def counted(log: EpisodeLog) -> _Counted:
        if log not in known:
            known[log] = count(log)
        return known[log]

    return counted


def moments(log: EpisodeLog) -> tuple[IntArray, WorldFacts]:
    """Return the steps at which a condition may change, and the facts at them.

    Positions in these facts only say whether an object is in its goal: they are the goal, or 1 m beside it.
    """
    edges = [edge for run in log.runs for edge in (run.begin, run.end - 1, run.end)]
    wanted = {event.step for event in log.events} | {0, log.steps - 1, log.steps, log.length - 1, *edges}
    steps = np.array(sorted(step for step in wanted if 0 <= step < log.length))
    events = [log.at(int(step)) for step in steps]
    goals = np.array([target.goal for target in log.targets])
    beside = np.zeros((len(steps), *goals.shape))
    beside[..., 0] = np.where(np.array([event.in_goal for event in events]), 0.0, _OUTSIDE)
    return steps, WorldFacts(
        goals + beside,
        goals,
        np.array([event.held for event in events]),
        np.array([event.drawer for event in events]),
        np.array([event.fridge for event in events]),
    )


@_once
def stage_steps(log: EpisodeLog) -> tuple[int, ...]:
    """Return the step at which each stage is first reached, counted as the benchmark does; `NEVER` where it is not."""
    steps, facts = moments(log)
    steps = steps[steps < log.steps]
    reached, since = [], 0
    for stage in log.home_task.stages:
        met = np.flatnonzero(stage.met(facts)[: len(steps)] & (steps >= since))
        if not len(met):
            break
        since = int(steps[met[0]])
        reached.append(since)
    return (*reached, *[NEVER] * (len(log.home_task.stages) - len(reached)))


def latched(log: EpisodeLog) -> tuple[bool, ...]:
    """Return which stages are reached, as the benchmark counts."""
    return tuple(step != NEVER for step in stage_steps(log))


def handled(log: EpisodeLog, target: int) -> tuple[int, int] | None:
    """Step in which the plan handles a target, (first, one past the last): from its pick to the end of its place.

    None when its pick never began; when its place never began, the rest of the episode.
    """
    pick, place = log.run("pick", target), log.run("place", target)
    if pick is None:
        return None
    return pick.begin, log.steps if place is None else place.end


@_once
def stabilizing(log: EpisodeLog) -> tuple[bool, ...]:
    """Return which placements are goal-stabilizing, as the thesis counts; none in an episode that diverged."""
    if log.diverged:
        return (False,) * len(log.targets)
    steps, facts = moments(log)
    handling = np.zeros((len(steps), len(log.targets)), dtype=bool)
    for target in range(len(log.targets)):
        span = handled(log, target)
        if span is not None:
            handling[:, target] = (steps >= span[0]) & (steps < span[1])
    return tuple(map(bool, goal_stabilizing(facts, handling, settle_steps=1)))


@_once
def stages_stabilizing(log: EpisodeLog) -> tuple[bool, ...]:
    """Return which stages count when every placement up to them must be goal-stabilizing."""
    counted = stabilizing_stages(log.home_task, np.array(latched(log)), np.array(stabilizing(log)))
    return tuple(map(bool, counted))


def blamed(log: EpisodeLog, stage: int) -> Predicate | None:
    """Return the condition that kept the first unmet stage (a number) from being reached.

    Looked at are the steps from the begin of the stage's own skill (and from the stage before it) to the end of the
    episode: at the last one of those at which most conditions hold, the first that does not, objects in their order
    first, then drawer and fridge, then the hand. None when the stage's own skill never ended, or began only when the
    episode was over.
    """
    conditions = sorted(log.home_task.stages[stage].conditions, key=_rank)
    skill, _, target = log.home_task.stages[stage].name.partition("_")
    run = log.run(skill, int(target))
    if run is None:
        return None
    begin = max(run.begin, stage_steps(log)[stage - 1] if stage else 0)
    steps, facts = moments(log)
    window = (steps >= begin) & (steps < log.steps)
    if not window.any():
        return None
    holds = np.stack([condition.holds(facts)[window] for condition in conditions], axis=1)
    counts = holds.sum(axis=1)
    best = len(counts) - 1 - int(np.argmax(counts[::-1]))
    return conditions[int(np.argmin(holds[best]))]


def _rank(condition: Predicate) -> tuple[int, int]:
    """Return order in which conditions are blamed."""
    group = 0 if condition.name == "at" else 2 if condition.name in ("holding", "not_holding") else 1
    return group, -1 if condition.target is None else condition.target
