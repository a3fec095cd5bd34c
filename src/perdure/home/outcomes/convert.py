"""From what the executor keeps, every pose at every step, to a record small enough to keep for every episode."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from perdure.home.episodes import Episode
from perdure.home.errors import HomeError
from perdure.home.execute.log import EpisodeLog, SkillRun
from perdure.home.objects import KINDS
from perdure.home.outcomes.counting import latched
from perdure.home.outcomes.records import UNTRAINED, EpisodeRecord, Event, Release, Run, Target, Track
from perdure.home.tasks import predicate
from perdure.home.tasks.predicates import PREDICATES, at
from perdure.home.world import CONTROL_HZ

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

MOVED, TURNED = 0.002, 0.01
"""Tracks leave out steps at which the object is within 2 mm of where it was, the height of its z axis within 0.01."""
GRID = 2.0**-13
"""Poses of tracks are rounded to multiples of this (0.12 mm), which lets a file shrink."""
_DOORS = [predicate(f"{name}()") for name in PREDICATES if name.endswith(("drawer", "fridge"))]


def record_of(log: EpisodeLog, run: Mapping[str, str]) -> EpisodeRecord:
    """Reduces a log to a record.

    Args:
        log: An executed episode.
        run: `arm`: what was run; `train_seed`: its training seed, left out where nothing was trained.

    Raises:
        HomeError: If `run` says too little, or the log's latched stages are not those its facts lead to.
    """
    # A world that blew up is put back to its start: the last row is no longer this episode.
    length = max(1, len(log.facts) - 1) if log.diverged else len(log.facts)
    episode, steps = log.episode, min(log.steps, length)
    record = EpisodeRecord(
        task=episode.task,
        split=episode.split,
        index=episode.index,
        episode_hash=episode_hash(episode),
        arm=_arm(run),
        train_seed=_train_seed(run),
        eval_seed=log.eval_seed,
        control_hz=float(CONTROL_HZ),
        steps=steps,
        length=length,
        diverged=log.diverged,
        targets=tuple(_target(episode, k) for k in range(len(episode.goals))),
        runs=tuple(_run(log, each, steps) for each in log.skills),
        events=_events(log, length),
        releases=_releases(log, length),
    )
    if latched(record) != tuple(map(bool, log.latched)):
        raise HomeError(f"{record.name}: its facts reach the stages {latched(record)}, its log says {log.latched}")
    return record


def episode_hash(episode: Episode) -> str:
    """SHA-256 of where an episode plays and what lies where, in hexadecimal."""
    places = [[p.kind, p.position, p.quaternion, p.receptacle] for p in (*episode.objects, *episode.goals)]
    content = [episode.task, episode.apartment_fingerprint, dict(episode.opened), places]
    return hashlib.sha256(json.dumps(content, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


def kept_steps(position: FloatArray, up: FloatArray) -> IntArray:
    """The steps a track keeps: the first, the last, and each at which the object has moved since the last one kept.

    Args:
        position: Shape (n, 3).
        up: Shape (n,).
    """
    points, heights = position.tolist(), up.tolist()
    kept = [0]
    for step in range(1, len(points)):
        last = kept[-1]
        if math.dist(points[step], points[last]) > MOVED or abs(heights[step] - heights[last]) > TURNED:
            kept.append(step)
    if kept[-1] != len(points) - 1:
        kept.append(len(points) - 1)
    return np.array(kept)


def _arm(run: Mapping[str, str]) -> str:
    if not run.get("arm"):
        raise HomeError(f"the run must say under 'arm' what was run, such as 'TP+SRL'; it says {dict(run)}")
    return run["arm"]


def _train_seed(run: Mapping[str, str]) -> int:
    text = run.get("train_seed", str(UNTRAINED))
    try:
        return int(text)
    except ValueError:
        raise HomeError(f"the run's train_seed must be a whole number, not {text!r}") from None


def _target(episode: Episode, number: int) -> Target:
    goal, link = episode.goals[number], episode.container(number)
    if goal.kind not in KINDS:
        raise HomeError(f"{episode.name} has a target of the kind {goal.kind!r}; there are {', '.join(KINDS)}")
    container = "" if link is None else "fridge" if link == "top_door" else "drawer"
    return Target(goal.kind, KINDS[goal.kind].cylinder, container, goal.position)


def _run(log: EpisodeLog, run: SkillRun, steps: int) -> Run:
    begin, end = min(run.begin, steps), min(run.end, steps)
    away = np.linalg.norm(log.gripper[begin:end] - log.facts.object_positions[begin:end, run.target], axis=1)
    return Run(
        number=run.number,
        skill=run.skill,
        target=run.target,
        begin=begin,
        end=end,
        ending=run.ending,
        success=run.success,
        forced_release=run.forced_release,
        force=float(log.contact_force[begin:end].max()) if end > begin else math.nan,
        reach=float(away.min()) if end > begin else math.nan,
    )


def _events(log: EpisodeLog, length: int) -> tuple[Event, ...]:
    facts = log.facts[:length]
    inside = at(facts)
    state = np.column_stack([facts.held, inside, *(door.holds(facts) for door in _DOORS)]).astype(np.int64)
    changes = np.concatenate([[0], 1 + np.flatnonzero((state[1:] != state[:-1]).any(axis=1))])
    return tuple(
        Event(
            step=int(k),
            held=int(facts.held[k]),
            in_goal=tuple(map(bool, inside[k])),
            drawer=float(facts.drawer[k]),
            fridge=float(facts.fridge[k]),
        )
        for k in changes
    )


def _releases(log: EpisodeLog, length: int) -> tuple[Release, ...]:
    held = np.asarray(log.facts.held[:length])
    let_go = np.flatnonzero((held[:-1] >= 0) & (held[1:] != held[:-1]))
    return tuple(_release(log, int(step), int(held[step]), length) for step in let_go)


def _release(log: EpisodeLog, step: int, target: int, length: int) -> Release:
    again = np.flatnonzero(log.facts.held[step + 1 : length] == target)
    rows = slice(step, step + 1 + int(again[0]) if len(again) else length)
    position, up = log.facts.object_positions[rows, target], log.object_up[rows, target]
    kept = kept_steps(position, up)
    before = max(step - 1, 0)
    return Release(
        target=target,
        object_speed=float(log.object_speed[step, target]),
        gripper_speed=float(np.linalg.norm(log.gripper[step] - log.gripper[before])) * CONTROL_HZ,
        base_speed=float(np.linalg.norm(log.base[step, :2] - log.base[before, :2])) * CONTROL_HZ,
        track=Track(
            step=step + kept,
            position=_rounded(position[kept]),
            up=_rounded(up[kept]),
            gripper=_rounded(log.gripper[rows][kept]),
            base=_rounded(log.base[rows][kept]),
        ),
    )


def _rounded(values: FloatArray) -> FloatArray:
    rounded: FloatArray = np.round(values / GRID) * GRID
    return rounded
