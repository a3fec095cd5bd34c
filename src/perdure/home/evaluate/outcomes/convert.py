"""From what the executor keeps, every pose at every step, to a record small enough to keep for every episode."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import replace

from perdure.home.benchmark.episodes import Episode
from perdure.home.errors import HomeError
from perdure.home.evaluate.execute.log import EpisodeLog, SkillRun
from perdure.home.evaluate.outcomes.counting import latched
from perdure.home.evaluate.outcomes.history import History
from perdure.home.evaluate.outcomes.records import UNTRAINED, EpisodeRecord, FinalObject, Run, Target
from perdure.home.sim.objects import KINDS
from perdure.home.sim.world import CONTROL_HZ


def record_of(log: EpisodeLog, run: Mapping[str, str]) -> EpisodeRecord:
    """Reduces a log to a record.

    Args:
        log: An executed episode.
        run: `arm`: what was run; `train_seed`: its training seed, left out where nothing was trained.

    Raises:
        HomeError: If `run` says too little, or the log's latched stages are not those its facts lead to. (Not looked at
            where the simulation blew up: the log has counted the step after it, too.)
    """
    # A world that blew up is put back to its start: the last row is no longer this episode.
    length = max(1, len(log.facts) - 1) if log.diverged else len(log.facts)
    episode, steps, history = log.episode, min(log.steps, length), _history(log, length)
    record = EpisodeRecord(
        task=episode.task,
        split=episode.split,
        index=episode.index,
        episode_hash=episode_hash(episode),
        arm=_arm(run),
        train_seed=_train_seed(run),
        eval_seed=log.eval_seed,
        control_hz=history.control_hz,
        steps=steps,
        length=length,
        diverged=log.diverged,
        targets=tuple(_target(episode, k) for k in range(len(episode.goals))),
        runs=tuple(_run(history, each, steps) for each in log.skills),
        events=history.events,
        releases=history.releases,
        final_objects=_final_objects(log),
    )
    if not log.diverged and latched(record) != tuple(map(bool, log.latched)):
        raise HomeError(f"{record.name}: its facts reach the stages {latched(record)}, its log says {log.latched}")
    return record


def episode_hash(episode: Episode) -> str:
    """SHA-256 of where an episode plays and what lies where, in hexadecimal."""
    places = [[p.kind, p.position, p.quaternion, p.receptacle] for p in (*episode.objects, *episode.goals)]
    content = [episode.task, episode.apartment_fingerprint, dict(episode.opened), places]
    return hashlib.sha256(json.dumps(content, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


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


def _final_objects(log: EpisodeLog) -> tuple[FinalObject, ...]:
    kinds = [placement.kind for placement in log.episode.objects]
    rows = zip(kinds, log.final_poses.tolist(), log.final_speeds.tolist(), strict=True)
    return tuple(
        FinalObject(kind, (pose[0], pose[1], pose[2]), (pose[3], pose[4], pose[5], pose[6]), speed, k == log.final_held)
        for k, (kind, pose, speed) in enumerate(rows)
    )


def _history(log: EpisodeLog, length: int) -> History:
    return History(
        facts=log.facts[:length],
        up=log.object_up[:length],
        speed=log.object_speed[:length],
        gripper=log.gripper[:length],
        base=log.base[:length],
        force=log.contact_force[:length],
        control_hz=float(CONTROL_HZ),
    )


def _run(history: History, run: SkillRun, steps: int) -> Run:
    begin, end = min(run.begin, steps), min(run.end, steps)
    bare = history.run(run.number, run.skill, run.target, begin, end, run.ending)
    return replace(bare, success=run.success, forced_release=run.forced_release)
