"""What became of an episode, from its log alone: stages and placements that count, and why it failed.

Two ways of counting: *latched*, as the benchmark counts (a stage that was reached stays reached), and *stabilizing*, as
the thesis does (a placed object stays in its goal). The rules are those of `perdure.home.tasks.tasks`. Between two
events no input of a condition changes, so conditions are evaluated only at events and at the first and the last step of
every run and of the settling time.

A failed episode has one label: its first unmet stage and one failure cause. `docs/home/outcomes.md` lists the lines by
which a cause is found; the first line that applies decides. "Our choice" marks thresholds that this package chose.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache
from itertools import accumulate
from operator import and_
from typing import Literal, get_args

import numpy as np

from perdure.home.evaluate.log import EpisodeLog, Release, SkillRun
from perdure.home.sim.arrays import BoolArray, FloatArray, IntArray
from perdure.home.sim.hand import GRASP_RADIUS
from perdure.home.sim.objects import KINDS
from perdure.home.sim.pieces import CONTAINERS
from perdure.home.tasks.tasks import (
    ABOUT_CONTAINERS,
    AT,
    NOTHING,
    SKILL_VERBS,
    SOMETHING_ELSE,
    Predicate,
    Stage,
    Verb,
    WorldFacts,
    at,
)

Counting = Literal["latched", "stabilizing"]
COUNTINGS: tuple[Counting, ...] = get_args(Counting)
SUCCESS = "success"
DID_NOT_LAST = "success that did not last"
OTHER = "other"
FailureCause = Literal[
    "diverged",
    "time-out",
    "wrong object grasped",
    "door not open",
    "door not closed",
    "collision",
    "not reached",
    "grasp missed",
    "thrown",
    "dropped",
    "displaced by the robot",
    "tipped",
    "rolled",
]
FAILURE_CAUSES: tuple[FailureCause, ...] = get_args(FailureCause)

COLLISION_FORCE = 2000.0
"""In [N], our choice. The arm presses on a table with 413 N (`docs/home/world.md`), and hands that open the fridge meet
its handle with up to 900 N: 2000 N is more than twice either. Contacts of the base do not count."""
THROWN_SPEED = 0.5
"""In [m/s], our choice. Let go so fast 0.1 m above a table, an object flies 0.07 m and slides 0.04 m (friction 0.3):
most of the goal's radius of 0.15 m."""
AFTER_RELEASE = 1 / 30
"""Seconds in which its speed right after the release is measured, one control step at least."""
GRAVITY = 9.81
"""In [m/s2]."""
DROPPED_HEIGHT = 0.1
"""In [m], our choice: two thirds of the goal's radius; it arrives with 1.4 m/s."""
FELL_OVER = 45.0
"""Change of its tilt in [deg] after which an object fell over, our choice: all but the flattest are past their edge
then."""
OFF_SUPPORT = 0.1
"""An object whose middle is so far in [m] below where it would rest is off its support, our choice: the middle of the
tallest object is 0.07 m lower when it lies."""
REST_SECONDS = 0.5
REST_MOVE = 0.005
"""An object that moves by less than 5 mm within half a second has come to rest, our choice."""
NEAR_GRIPPER = 0.25
NEAR_BASE = 0.5
"""The robot is near when the gripper point is within 0.25 m of the object's middle (hand and half the largest object),
or the base's middle within 0.5 m of it in the plane (base and half the largest object), our choice."""
FINAL_SECONDS = 5.0
"""The final state must last so long."""
NEVER = -1
"""In place of a step that never came."""
_OUTSIDE = 1.0
"""Distance from the goal in [m] in the facts of an object that an event reports outside its goal."""
_once = lru_cache(maxsize=4096)


@_once
def moments(log: EpisodeLog) -> tuple[IntArray, WorldFacts]:
    """Return the steps at which a condition may change, and the facts at them.

    Positions in these facts only say whether an object is in its goal: they are the goal, or 1 m beside it.
    """
    edges = [edge for run in log.runs for edge in (run.begin, run.end - 1, run.end)]
    wanted = {event.step for event in log.events} | {0, log.steps - 1, log.steps, log.length - 1, *edges}
    steps = np.array(sorted(step for step in wanted if 0 <= step < log.length))
    events = [log.at(step) for step in steps.tolist()]
    goals = np.array([target.goal for target in log.targets])
    beside = np.zeros((len(steps), *goals.shape))
    beside[..., 0] = np.where(np.array([event.in_goal for event in events]), 0.0, _OUTSIDE)
    held = np.array([event.held for event in events])
    containers = {name: np.array([event.positions[name] for event in events]) for name in events[0].positions}
    return steps, WorldFacts(goals + beside, goals, held, containers)


@_once
def stage_steps(log: EpisodeLog) -> tuple[int, ...]:
    """Return the step at which each stage is first reached, counted as the benchmark does; `NEVER` where it is not."""
    steps, facts = moments(log)
    steps = steps[steps < log.steps]
    reached: list[int] = []
    since = 0
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


def handled(log: EpisodeLog, target: int, once: bool = False) -> tuple[int, int] | None:
    """Step in which the plan handles a target, (first, one past the last): from its first pick to its last place.

    None when its pick never ended; when no place ended after the last pick, the rest of the episode. `once`: to its
    first place, as if the plan had not looked again.
    """
    runs = [run for run in log.runs if run.target == target and SKILL_VERBS.get(run.skill) in (Verb.PICK, Verb.PLACE)]
    picks = [run.begin for run in runs if SKILL_VERBS[run.skill] == Verb.PICK]
    places = [k for k, run in enumerate(runs) if SKILL_VERBS[run.skill] == Verb.PLACE]
    if not picks:
        return None
    if once and places:
        runs = runs[: places[0] + 1]
    return picks[0], runs[-1].end if SKILL_VERBS[runs[-1].skill] == Verb.PLACE else log.steps


def stays(log: EpisodeLog, target: int, once: bool = False) -> bool:
    """Return whether a target is in its goal and not held at every step after `handled`; none is if it diverged."""
    steps, facts = moments(log)
    span = handled(log, target, once)
    there = at(facts)[:, target] & (facts.held != target)
    return not log.diverged and span is not None and bool(there[steps >= span[1]].all())


@_once
def stabilizing(log: EpisodeLog) -> tuple[bool, ...]:
    """Return which placements are goal-stabilizing, as the thesis counts; none in an episode that diverged."""
    return tuple(stays(log, target) for target in range(len(log.targets)))


@_once
def stages_stabilizing(log: EpisodeLog) -> tuple[bool, ...]:
    """Return which stages count when every placement up to them must be goal-stabilizing."""
    stages = zip(log.home_task.stages, latched(log), strict=True)
    counts = (reached and (stage.placed is None or stabilizing(log)[stage.placed]) for stage, reached in stages)
    return tuple(accumulate(counts, and_))


@_once
def final_state(log: EpisodeLog) -> bool:
    """Return whether in every step of the last five seconds all targets are in their goals and the hand is empty."""
    since = max(0, log.length - round(FINAL_SECONDS * log.control_hz))
    states = [log.at(since), *(event for event in log.events if event.step > since)]
    return not log.diverged and all(all(each.in_goal) and each.held == NOTHING for each in states)


def blamed(log: EpisodeLog, stage: int) -> Predicate | None:
    """Return the condition that kept the first unmet stage (a number) from being reached.

    Looked at are the steps from the begin of the stage's own skill (and from the stage before it) to the end of the
    episode: at the last one of those at which most conditions hold, the first that does not, objects in their order
    first, then containers, then the hand. None when the stage's own skill never ended, or began only when the
    episode was over.
    """
    wanted = log.home_task.stages[stage]
    conditions = sorted(wanted.conditions, key=_rank)
    run = log.run(wanted.verb, wanted.target)
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
    groups = {"at": 0, **dict.fromkeys(ABOUT_CONTAINERS, 1)}
    return groups.get(condition.name, 2), -1 if condition.target is None else condition.target


def placement(log: EpisodeLog, target: int, once: bool = False) -> Release | None:
    """Return the placement of a target: its last release while it was `handled`, None if it was never released."""
    first, end = handled(log, target, once) or (0, 0)
    return next((r for r in reversed(log.releases) if r.target == target and first <= r.step < end), None)


def failure_cause(log: EpisodeLog, stage: int, condition: Predicate | None) -> FailureCause:
    """Return the failure cause of an episode.

    `stage` is the number of its first unmet stage, `condition` what `blamed` found, or `at(k)` for a placement
    that is not goal-stabilizing.
    """
    if log.diverged:
        return "diverged"
    if condition is not None and condition.name == "at":
        assert condition.target is not None
        return placement_cause(log, placement(log, condition.target))
    run = log.run(log.home_task.stages[stage].verb, log.home_task.stages[stage].target)
    if condition is None or run is None or run.ending == "task limit" or condition.name == "not_holding":
        return "time-out"
    if condition.name == "holding":
        return _pick_cause(log, run)
    if _collided(log, run):
        return "collision"
    return "door not open" if condition.name == "opened" else "door not closed"


def _pick_cause(log: EpisodeLog, run: SkillRun) -> FailureCause:
    held = {e.held for e in log.events if run.begin <= e.step < run.end} | {log.at(run.begin).held}
    if any(each == SOMETHING_ELSE or each >= 0 for each in held - {run.target}):
        return "wrong object grasped"
    container = log.targets[run.target].container
    if container and log.at(run.begin).positions[container] < CONTAINERS[container].opened:
        return "door not open"
    if _collided(log, run):
        return "collision"
    return "not reached" if run.reach > GRASP_RADIUS else "grasp missed"


def _collided(log: EpisodeLog, run: SkillRun) -> bool:
    """Return whether force exceeded the limit in the run or in the navigation before it to the same target."""
    ways = [r for r in log.runs if r.skill == "navigate" and r.target == run.target and r.end <= run.begin]
    return any(each.force > COLLISION_FORCE for each in (*ways[-1:], run))


def placement_cause(log: EpisodeLog, release: Release | None) -> FailureCause:
    """Return why a placement failed or did not last."""
    if log.diverged:
        return "diverged"
    if release is None:
        return "time-out"
    inside = in_goal_since(log, release)
    left = _left(inside)
    if _taken_out(log, release):
        return "displaced by the robot"
    rested = None if left is None else _rested(log, release, inside, left)
    if left is not None and rested is not None:
        if _robot_near(release, rested, left):
            return "displaced by the robot"
        return "tipped" if _fell_over(log, release, rested, left) else "rolled"
    return _release_cause(log, release, inside, left)


def _release_cause(log: EpisodeLog, release: Release, inside: BoolArray, left: int | None) -> FailureCause:
    """Return why an object failed that never came to rest in its goal: what happened at its release, or after it."""
    run = log.run_at(release.step)
    if run is not None and run.forced_release and release.step == run.end - 1:
        return "time-out"
    if run is not None and run.force > COLLISION_FORCE:
        return "collision"
    if _thrown(log, release):
        return "thrown"
    away, above = release_offset(log, release)
    if away > AT and not inside.any():
        return "not reached"
    if above > DROPPED_HEIGHT:
        return "dropped"
    last = len(inside) - 1 if left is None else left
    return "tipped" if _fell_over(log, release, 0, last) else "rolled"


def _thrown(log: EpisodeLog, release: Release) -> bool:
    """Return whether the object was fast in the hand, and still right after it was let go."""
    track = release.track.thin
    steps = max(1, round(log.control_hz * AFTER_RELEASE))
    steps = min(steps, int(track.step[-1]) - release.step)
    if release.object_speed <= THROWN_SPEED or steps == 0:
        return release.object_speed > THROWN_SPEED
    seconds = steps / log.control_hz
    moved = np.diff(track.position[track.rows(release.step, release.step + steps)][[0, -1]], axis=0)[0]
    unfallen = moved + np.array([0.0, 0.0, 0.5 * GRAVITY * seconds**2])  # a drop alone is no throw
    return float(min(np.linalg.norm(moved), np.linalg.norm(unfallen))) / seconds > THROWN_SPEED / 2


def release_offset(log: EpisodeLog, release: Release) -> tuple[float, float]:
    """Return the offset of a release from the rest position in the goal: horizontal and upward, in [m]."""
    offset = release.track.position[0] - np.array(log.targets[release.target].goal)
    return float(np.hypot(offset[0], offset[1])), float(offset[2])


def in_goal_since(log: EpisodeLog, release: Release) -> BoolArray:
    """Return whether the object was in its goal at each step of its track, from the release on. Shape (n,)."""
    steps = np.arange(release.step, int(release.track.step[-1]) + 1)
    events = np.searchsorted([event.step for event in log.events], steps, side="right") - 1
    return np.array([event.in_goal[release.target] for event in log.events])[events]


def _left(inside: BoolArray) -> int | None:
    """Return the last step since the release before which the object was in its goal and at which it was not."""
    left = np.flatnonzero(inside[:-1] & ~inside[1:])
    return int(left[-1]) + 1 if len(left) else None


def _taken_out(log: EpisodeLog, release: Release) -> bool:
    last = int(release.track.step[-1])
    again = last + 1 < log.length and log.at(last + 1).held == release.target
    return again and log.at(last).in_goal[release.target]


def _rested(log: EpisodeLog, release: Release, inside: BoolArray, left: int) -> int | None:
    """Return the step since the release at which the object's last rest in its goal, before it left, was half over."""
    window = _rest_steps(log)
    if left < window + 1:
        return None
    position = release.track.thin.position[release.track.thin.rows(release.step, release.step + left - 1)]
    moved = np.linalg.norm(position[window:] - position[:-window], axis=1)
    still = np.flatnonzero((moved < REST_MOVE) & inside[: left - window] & inside[window:left])
    return int(still[-1]) + window // 2 if len(still) else None


def _robot_near(release: Release, first: int, last: int) -> bool:
    """Return whether hand or base were near the object at a step of its track, counted from the release."""
    track = release.track.thin
    since = track.step - release.step
    rows = (since > first) & (since <= last)
    hand = np.linalg.norm(track.gripper[rows] - track.position[rows], axis=1) <= NEAR_GRIPPER
    base = np.linalg.norm(track.base[rows, :2] - track.position[rows, :2], axis=1) <= NEAR_BASE
    return bool((hand | base).any())


def _fell_over(log: EpisodeLog, release: Release, first: int, left: int) -> bool:
    """Return whether the object fell over between a step, counted from the release, and half a second after it left."""
    kind = KINDS.get(log.targets[release.target].kind)
    if kind is not None and kind.shape == "sphere":
        return False
    track = release.track.thin
    last = min(release.step + left + _rest_steps(log), int(track.step[-1]))
    rows = track.rows(release.step + first, last)
    falling = track.position[rows, 2] < log.targets[release.target].goal[2] - OFF_SUPPORT
    angle = tilt(track.up[rows[: int(np.argmax(falling)) if falling.any() else None]])
    return len(angle) > 0 and bool(np.abs(angle - angle[0]).max() > FELL_OVER)


def _rest_steps(log: EpisodeLog) -> int:
    return max(2, round(REST_SECONDS * log.control_hz))


def tilt(up: FloatArray) -> FloatArray:
    """Return angle in [deg] between an object's z axis and the vertical, from the height of that axis."""
    return np.degrees(np.arccos(np.clip(up, -1.0, 1.0)))


@dataclass(frozen=True)
class Label:
    """Why an episode failed."""

    stage: Stage
    """First unmet stage."""
    cause: FailureCause
    target: int
    """Number of the object: the one that is not in its goal, else that of the stage."""
    condition: Predicate | None = field(default=None, compare=False)
    """What is blamed, `at(k)` for a placement; None when the skill never ended."""


def label(log: EpisodeLog, counting: Counting) -> Label | None:
    """Return the label of an episode, None when it succeeded by this way of counting."""
    reached = latched(log)
    counted = reached if counting == "latched" else stages_stabilizing(log)
    if all(counted):
        return None
    number = counted.index(False)
    stage = log.home_task.stages[number]
    condition = Predicate("at", stage.placed) if reached[number] else blamed(log, number)
    target = stage.target
    if condition is not None and condition.name == "at" and condition.target is not None:
        target = condition.target
    return Label(stage, failure_cause(log, number, condition), target, condition)


def outcome(log: EpisodeLog) -> str:
    """Return the outcome of an episode in the categories of the thesis' figures 2-1 and 2-3.

    `success`, or `success that did not last`: the benchmark counts it, but a placement is not goal-stabilizing. Of the
    failed ones: `place_k` when the first stage that does not count, placements being goal-stabilizing, is that one;
    else `other`.
    """
    if all(latched(log)):
        return SUCCESS if all(stages_stabilizing(log)) else DID_NOT_LAST
    stage = log.home_task.stages[stages_stabilizing(log).index(False)]
    return OTHER if stage.placed is None else stage.name
