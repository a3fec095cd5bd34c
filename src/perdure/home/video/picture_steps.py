"""Which eight steps of a failed episode show the cause of its failure."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from perdure.home.benchmark.tasks import AT, NOTHING, Predicate
from perdure.home.evaluate.log import EpisodeLog, History, Release, SkillRun
from perdure.home.evaluate.outcomes import Label, placement
from perdure.home.evaluate.outcomes.counting import blamed, latched
from perdure.home.evaluate.outcomes.failure_causes import REST_MOVE, in_goal_since
from perdure.home.sim.arrays import FloatArray
from perdure.home.sim.world import CONTROL_HZ
from perdure.home.video.replay import Replay

PICTURES = 8
BEFORE = CONTROL_HZ
"""Steps before a release at which the first picture is taken: 1 s."""
NEARBY = 2.0 * AT
"""Moments after a release are spaced by the object's way while it is so near to its goal in [m] ..."""
PACE = 0.002
"""... and by time, of which a second counts as much as a way of 2 mm: an object that rests uses up few pictures."""


def condition_of(log: EpisodeLog, found: Label) -> Predicate | None:
    """Return the condition that a label blames, `at(k)` for a placement; None when the skill never ended."""
    number = [stage.name for stage in log.home_task.stages].index(found.stage)
    return Predicate("at", found.target) if latched(log)[number] else blamed(log, number)


def picture_steps(replay: Replay, found: Label, condition: Predicate | None) -> dict[int, str]:
    """Return the steps to show, in order, each with a note on what happens there; fillers have an empty note.

    `condition` is what the label blames, see `condition_of`.
    """
    log = replay.log
    release = placement(log, found.target) if condition is not None and condition.name == "at" else None
    if log.diverged:
        keys, way = {max(0, log.length - 2 * CONTROL_HZ): "", log.length - 1: "diverges"}, _time(log)
    elif release is not None:
        keys, way = _after_release(replay, release)
        placed = log.run("place", found.target)
        keys = keys | _hardest(replay.history, placed) if placed and found.cause == "collision" else keys
    else:
        keys, way = _in_run(replay, found, condition), _time(log)
    steps = _fill(sorted(keys), way)
    return {step: keys.get(step, "") for step in steps}


def _time(log: EpisodeLog) -> FloatArray:
    return np.arange(log.length, dtype=np.float64)


def _after_release(replay: Replay, release: Release) -> tuple[dict[int, str], FloatArray]:
    """Return the steps to show of a placement, and a measure of progress at each step. Shape (steps,)."""
    log, start = replay.log, release.step
    end = min(int(release.track.step[-1]) + CONTROL_HZ, log.length - 1)
    position = replay.history.facts.object_positions[: log.length, release.target]
    moving = np.flatnonzero(np.linalg.norm(position[start:end] - position[end], axis=1) > REST_MOVE)
    rest = min(start + max(CONTROL_HZ, int(moving.max(initial=-1)) + 1), end)
    inside = in_goal_since(log, release)
    left = [start + 1 + int(k) for k in np.flatnonzero(inside[:-1] & ~inside[1:])[-1:]]
    keys = {max(0, start - BEFORE): "", start: "releases", **dict.fromkeys(left, "left its goal")}
    near = np.linalg.norm(position - log.targets[release.target].goal, axis=1) < NEARBY
    pace = np.linalg.norm(np.diff(position, axis=0), axis=1) * near[1:] + PACE / CONTROL_HZ
    pace[:start] = 0.0
    return keys | {rest: keys.get(rest, "")}, np.concatenate([[0.0], np.cumsum(pace)])


def _in_run(replay: Replay, found: Label, condition: Predicate | None) -> dict[int, str]:
    """Return the first and the last step of the skill that failed, and the step of its failure cause."""
    log, history = replay.log, replay.history
    run = failed_run(log, found)
    last = log.steps - 1 if run is None else max(run.end - 1, 0)
    first = max(0, min(last - BEFORE, last if run is None else run.begin))
    keys, steps = {first: "", last: ""}, slice(first, last + 1)
    if run is not None and found.cause == "collision":
        return keys | _hardest(history, run)
    if found.cause == "wrong object grasped":
        wrong = ~np.isin(history.facts.held[steps], (NOTHING, found.target))
        return keys | {first + int(np.argmax(wrong)): "another object in the hand"}
    if condition is not None and condition.name == "holding":
        away = np.linalg.norm(history.gripper[steps] - history.facts.object_positions[steps, found.target], axis=1)
        return keys | {first + int(np.argmin(away)): f"nearest, {away.min():.3f} m away"}
    if condition is not None and found.cause.startswith("door") and not _its_own(log, found, condition):
        holds = condition.holds(history.facts)[: last + 1]
        undone = f"no longer {condition.name.partition('_')[0]}"
        lost = 1 + np.flatnonzero(holds[:-1] & ~holds[1:])[-1:]
        keys |= {step: note for k in lost for step, note in ((max(0, int(k) - BEFORE), ""), (int(k), undone))}
    return keys


def _hardest(history: History, run: SkillRun) -> dict[int, str]:
    """Return the step of the largest contact force in a run."""
    step = run.begin + int(np.argmax(history.force[run.begin : max(run.end, run.begin + 1)]))
    return {step: f"largest force, {history.force[step]:.0f} N"}


def _its_own(log: EpisodeLog, found: Label, condition: Predicate) -> bool:
    """Return whether the stage's own skill establishes a condition; otherwise something undid it."""
    verb, _, number = found.stage.partition("_")
    return condition.name.startswith(verb) and condition.name.endswith(log.targets[int(number)].container)


def failed_run(log: EpisodeLog, found: Label) -> SkillRun | None:
    """Return the run of the label's skill, or its navigation if that collided harder; else the last run."""
    skill, _, number = found.stage.partition("_")
    run = log.run(skill, int(number))
    if run is None:
        return log.runs[-1] if log.runs else None
    if found.cause != "collision":
        return run
    ways = [r for r in log.runs if r.skill == "navigate" and r.target == run.target and r.end <= run.begin]
    return max((run, *ways[-1:]), key=lambda each: each.force)


def _fill(keys: Sequence[int], way: FloatArray) -> list[int]:
    """Return up to `PICTURES` steps: `keys`, and between them others at even distances along `way`."""
    parts = np.ones(len(keys) - 1, dtype=np.int64)
    gaps, room = np.diff(way[list(keys)]), np.diff(keys)
    while parts.sum() + 1 < PICTURES and (free := (parts < room) & (gaps > 0.0)).any():
        parts[np.argmax(np.where(free, gaps / parts, -1.0))] += 1
    steps = set(keys)
    for first, last, count in zip(keys[:-1], keys[1:], parts, strict=True):
        wanted, number = np.linspace(way[first], way[last], count + 1)[1:-1], np.arange(1, count)
        rising = np.maximum.accumulate(np.searchsorted(way, wanted - 1e-9) - number) + number
        steps |= set(map(int, np.clip(rising, first + number, last - count + number)))
    return sorted(steps)
