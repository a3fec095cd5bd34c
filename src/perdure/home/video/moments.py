"""Which eight moments of a failed episode show what its label is about."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from perdure.home.benchmark.tasks import AT, NOTHING, Predicate
from perdure.home.evaluate.execute import EpisodeLog
from perdure.home.evaluate.outcomes import EpisodeRecord, Label, placement
from perdure.home.evaluate.outcomes.counting import blamed, latched
from perdure.home.evaluate.outcomes.failure_causes import REST_MOVE, in_goal_since
from perdure.home.evaluate.outcomes.records import Release, Run
from perdure.home.sim.world import CONTROL_HZ
from perdure.home.video.replay import Replay

FloatArray = NDArray[np.float64]

PICTURES = 8
BEFORE = CONTROL_HZ
"""Steps before a release at which the first picture is taken: 1 s."""
NEARBY = 2.0 * AT
"""Moments after a release are spaced by the object's way while it is so near to its goal in [m] ..."""
PACE = 0.002
"""... and by time, of which a second counts as much as a way of 2 mm: an object that rests uses up few pictures."""


def condition_of(record: EpisodeRecord, found: Label) -> Predicate | None:
    """The condition that a label blames, `at(k)` for a placement; None when the stage's own skill never ended."""
    number = [stage.name for stage in record.home_task.stages].index(found.stage)
    return Predicate("at", found.target) if latched(record)[number] else blamed(record, number)


def moments(replay: Replay, found: Label, condition: Predicate | None) -> dict[int, str]:
    """The steps to take pictures at, in their order, and what happens at those that are not just fillers.

    Args:
        replay: The episode.
        found: Its label.
        condition: What that blames, see `condition_of`.
    """
    record = replay.record
    release = placement(record, found.target) if condition is not None and condition.name == "at" else None
    if record.diverged:
        keys, way = {max(0, record.length - 2 * CONTROL_HZ): "", record.length - 1: "diverges"}, _time(record)
    elif release is not None:
        keys, way = _after_release(replay, release)
        placed = record.run("place", found.target)
        keys = keys | _hardest(replay.log, placed) if placed and found.mechanism == "collision" else keys
    else:
        keys, way = _in_run(replay, found, condition), _time(record)
    steps = _fill(sorted(keys), way)
    return {step: keys.get(step, "") for step in steps}


def _time(record: EpisodeRecord) -> FloatArray:
    return np.arange(record.length, dtype=np.float64)


def _after_release(replay: Replay, release: Release) -> tuple[dict[int, str], FloatArray]:
    """The moments one must see of a placement, and how far things have gone at each step. Shape (steps,)."""
    record, start = replay.record, release.step
    end = min(int(release.track.step[-1]) + CONTROL_HZ, record.length - 1)
    position = replay.log.facts.object_positions[: record.length, release.target]
    moving = np.flatnonzero(np.linalg.norm(position[start:end] - position[end], axis=1) > REST_MOVE)
    rest = min(start + max(CONTROL_HZ, int(moving.max(initial=-1)) + 1), end)
    inside = in_goal_since(record, release)
    left = [start + 1 + int(k) for k in np.flatnonzero(inside[:-1] & ~inside[1:])[-1:]]
    keys = {max(0, start - BEFORE): "", start: "lets go", **dict.fromkeys(left, "left its goal")}
    near = np.linalg.norm(position - record.targets[release.target].goal, axis=1) < NEARBY
    pace = np.linalg.norm(np.diff(position, axis=0), axis=1) * near[1:] + PACE / CONTROL_HZ
    pace[:start] = 0.0
    return keys | {rest: keys.get(rest, "")}, np.concatenate([[0.0], np.cumsum(pace)])


def _in_run(replay: Replay, found: Label, condition: Predicate | None) -> dict[int, str]:
    """The first and the last moment of the skill that failed, and the one that its label speaks of."""
    record, log = replay.record, replay.log
    run = failed_run(record, found)
    last = record.steps - 1 if run is None else max(run.end - 1, 0)
    first = max(0, min(last - BEFORE, last if run is None else run.begin))
    keys, steps = {first: "", last: ""}, slice(first, last + 1)
    if run is not None and found.mechanism == "collision":
        return keys | _hardest(log, run)
    if found.mechanism == "wrong object grasped":
        wrong = ~np.isin(log.facts.held[steps], (NOTHING, found.target))
        return keys | {first + int(np.argmax(wrong)): "another one in the hand"}
    if condition is not None and condition.name == "holding":
        away = np.linalg.norm(log.gripper[steps] - log.facts.object_positions[steps, found.target], axis=1)
        return keys | {first + int(np.argmin(away)): f"nearest, {away.min():.3f} m away"}
    if condition is not None and found.mechanism.startswith("door") and not _its_own(record, found, condition):
        holds = condition.holds(log.facts)[: last + 1]
        undone = f"no longer {condition.name.partition('_')[0]}"
        lost = 1 + np.flatnonzero(holds[:-1] & ~holds[1:])[-1:]
        keys |= {step: note for k in lost for step, note in ((max(0, int(k) - BEFORE), ""), (int(k), undone))}
    return keys


def _hardest(log: EpisodeLog, run: Run) -> dict[int, str]:
    """The moment of the largest contact force in a run."""
    step = run.begin + int(np.argmax(log.contact_force[run.begin : max(run.end, run.begin + 1)]))
    return {step: f"largest force, {log.contact_force[step]:.0f} N"}


def _its_own(record: EpisodeRecord, found: Label, condition: Predicate) -> bool:
    """Whether the stage's own skill should have brought a condition about; else something undid it."""
    verb, _, number = found.stage.partition("_")
    return condition.name.startswith(verb) and condition.name.endswith(record.targets[int(number)].container)


def failed_run(record: EpisodeRecord, found: Label) -> Run | None:
    """The run of the label's skill; of a collision the navigation to it, if that met more. The last one if none."""
    skill, _, number = found.stage.partition("_")
    run = record.run(skill, int(number))
    if run is None:
        return record.runs[-1] if record.runs else None
    if found.mechanism != "collision":
        return run
    ways = [r for r in record.runs if r.skill == "navigate" and r.target == run.target and r.end <= run.begin]
    return max((run, *ways[-1:]), key=lambda each: each.force)


def _fill(keys: Sequence[int], way: FloatArray) -> list[int]:
    """Up to `PICTURES` steps: `keys`, and between them others, evenly by the way made."""
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
