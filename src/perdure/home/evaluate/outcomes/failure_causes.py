"""The cause of a failure, from a log alone.

A failed episode is blamed on one condition of its first unmet stage (`counting.blamed`). For that condition the first
line that applies gives the failure cause:

| blamed | line | applies when | cause |
|---|---|---|---|
| anything | 1 | the simulation blew up | diverged |
| | 2 | the stage's own skill never ended, or the task's limit ended it | time-out |
| `holding(k)` | 3 | in the pick the hand held another object or a handle | wrong object grasped |
| | 4 | the drawer or fridge the object lies in was not open when the pick began | door not open |
| | 5 | contact force above `COLLISION_FORCE` in the pick or on the way to it | collision |
| | 6 | the gripper point never came within `GRASP_RADIUS` of the object | not reached |
| | 7 | otherwise | grasp missed |
| a door's | 8 | contact force above `COLLISION_FORCE` in its skill or on the way to it | collision |
| | 9 | otherwise | door not open, door not closed |
| `not_holding()` | 10 | always | time-out |
| `at(k)` | 11 | the cause of k's placement, below | |

For a placement, blamed or counted as not goal-stabilizing:

| line | applies when | cause |
|---|---|---|
| 1 | the simulation blew up | diverged |
| 2 | the hand never let go of it | time-out |
| 3 | the hand took it out of its goal again | displaced by the robot |
| 4 | it came to rest in its goal, and the robot was near when it left | displaced by the robot |
| 5 | it came to rest in its goal, and fell over before it left | tipped |
| 6 | it came to rest in its goal, and left | rolled |
| 7 | the hand was opened by force | time-out |
| 8 | contact force above `COLLISION_FORCE` in the skill in which it was let go | collision |
| 9 | its speed was above `THROWN_SPEED` in the hand, and above half of that right after the release | thrown |
| 10 | it was let go beside its goal and never came into it | not reached |
| 11 | it was let go more than `DROPPED_HEIGHT` above where it would rest | dropped |
| 12 | it fell over | tipped |
| 13 | otherwise | rolled |

It "left" at the first step out of its goal after the last one in it. It "fell over" when its tilt changed by more than
`FELL_OVER` before it left or within half a second after, but not while it was falling off its support; a ball has no
upright to fall from. A box that slides "rolled" too. A world may remove an object's velocity at the release
(`SceneOptions.release_velocity`): what then drops straight down was not thrown. Without a step after the release, the
speed in the hand decides.

A log of another simulator may lack `force` or `reach` (nan). Without `force` nothing is a collision, and the page says
so; without `reach` a pick is never "not reached".
"""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np

from perdure.home.benchmark.tasks import AT, SOMETHING_ELSE, Predicate
from perdure.home.benchmark.tasks.predicates import DRAWER_OPEN, FRIDGE_OPENED
from perdure.home.evaluate.log import EpisodeLog, Release, SkillRun
from perdure.home.evaluate.outcomes.counting import handled
from perdure.home.sim.arrays import BoolArray, FloatArray
from perdure.home.sim.objects import KINDS
from perdure.home.sim.world import GRASP_RADIUS

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
"""In [N], OURS. The arm presses on a table with 413 N (`docs/home/robot.md`), and hands that open the fridge meet its
handle with up to 900 N: 2000 N is more than twice either. Contacts of the base do not count."""
THROWN_SPEED = 0.5
"""In [m/s], OURS. Let go so fast 0.1 m above a table, an object flies 0.07 m and slides 0.04 m (friction 0.3): most of
the goal's radius of 0.15 m."""
AFTER_RELEASE = 1 / 30
"""Seconds in which its speed right after the release is measured, one control step at least."""
GRAVITY = 9.81
"""In [m/s2]."""
DROPPED_HEIGHT = 0.1
"""In [m], OURS: two thirds of the goal's radius; it arrives with 1.4 m/s."""
FELL_OVER = 45.0
"""Change of its tilt in [deg] after which an object fell over, OURS: all but the flattest are past their edge then."""
OFF_SUPPORT = 0.1
"""An object whose middle is so far in [m] below where it would rest is off its support, OURS: the middle of the tallest
object is 0.07 m lower when it lies."""
REST_SECONDS, REST_MOVE = 0.5, 0.005
"""An object that moves by less than 5 mm within half a second has come to rest, OURS."""
NEAR_GRIPPER, NEAR_BASE = 0.25, 0.5
"""The robot is near when the gripper point is within 0.25 m of the object's middle (hand and half the largest object),
or the base's middle within 0.5 m of it in the plane (base and half the largest object), OURS."""


def placement(log: EpisodeLog, target: int) -> Release | None:
    """Return the placement of a target: its last release while the plan handled it, None if it was never released."""
    span = handled(log, target)
    if span is None:
        return None
    found = [r for r in log.releases if r.target == target and span[0] <= r.step < span[1]]
    return found[-1] if found else None


def failure_cause(log: EpisodeLog, stage: int, condition: Predicate | None) -> FailureCause:
    """Return the failure cause of an episode: the first table of this file.

    `stage` is the number of its first unmet stage, `condition` what `counting.blamed` found, or `at(k)` for a placement
    that is not goal-stabilizing.
    """
    if log.diverged:
        return "diverged"
    if condition is not None and condition.name == "at":
        assert condition.target is not None
        return placement_cause(log, condition.target)
    skill, _, target = log.home_task.stages[stage].name.partition("_")
    run = log.run(skill, int(target))
    if condition is None or run is None or run.ending == "task limit" or condition.name == "not_holding":
        return "time-out"
    if condition.name == "holding":
        return _pick_cause(log, run)
    if _collided(log, run):
        return "collision"
    return "door not open" if condition.name.startswith("opened") else "door not closed"


def _pick_cause(log: EpisodeLog, run: SkillRun) -> FailureCause:
    held = {e.held for e in log.events if run.begin <= e.step < run.end} | {log.at(run.begin).held}
    if any(each == SOMETHING_ELSE or each >= 0 for each in held - {run.target}):
        return "wrong object grasped"
    begin, container = log.at(run.begin), log.targets[run.target].container
    shut = {"drawer": begin.drawer < DRAWER_OPEN, "fridge": begin.fridge < FRIDGE_OPENED}
    if shut.get(container, False):
        return "door not open"
    if _collided(log, run):
        return "collision"
    return "not reached" if run.reach > GRASP_RADIUS else "grasp missed"


def _collided(log: EpisodeLog, run: SkillRun) -> bool:
    """Return whether force exceeded the limit in the run or in the navigation before it to the same target."""
    ways = [r for r in log.runs if r.skill == "navigate" and r.target == run.target and r.end <= run.begin]
    return any(each.force > COLLISION_FORCE for each in (*ways[-1:], run))


def placement_cause(log: EpisodeLog, target: int) -> FailureCause:
    """Return why a placement failed or did not last: the second table of this file."""
    release = placement(log, target)
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
    run = next((r for r in log.runs if r.begin <= release.step < r.end), None)
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
    track, steps = release.track.thin, max(1, round(log.control_hz * AFTER_RELEASE))
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
