"""Sheets of eight pictures that show what the label of a failed episode is about, so that it can be checked by eye.

The pictures are taken of a double, put into the states that a replay went through.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from perdure.home.benchmark.tasks import Predicate
from perdure.home.evaluate.outcomes import Label, placement
from perdure.home.evaluate.outcomes.counting import stage_steps
from perdure.home.evaluate.outcomes.failure_causes import in_goal_since, release_offset, tilt
from perdure.home.sim.world import CONTROL_HZ
from perdure.home.video.cameras import Shot
from perdure.home.video.film import tile
from perdure.home.video.follow import Follower
from perdure.home.video.marks import goal_marks
from perdure.home.video.moments import condition_of, failed_run, moments
from perdure.home.video.narrate import Narrator, Told
from perdure.home.video.render_scene import RenderScene
from perdure.home.video.replay import Failure, Replay
from perdure.home.video.studio import Studio
from perdure.home.video.words import write_strip, write_title

FloatArray = NDArray[np.float64]
Picture = NDArray[np.uint8]

COLUMNS, SIZE = 4, (480, 320)
"""Of one sheet; width and height of a picture in pixels, without the strip below."""
DIRECTIONS = np.array(list(product(np.arange(24) * (np.pi / 12.0), np.radians([12.0, 24.0, 36.0, 50.0, 65.0]))))
"""Azimuths and elevations of the camera that are tried, in [rad]."""
USUAL_ELEVATION = np.radians(36.0)
FAR_HAND = 1.5
"""A hand farther from a handle than this in [m] is not looked at: it is about something else."""
NEAR, ZOOM, FAR = 1.3, 1.7, 4.5
"""The camera is NEAR + ZOOM * (distance of the two things it looks at) away, FAR at most, in [m]."""


def failure_sheet(failure: Failure, replay: Replay) -> Picture:
    """The pictures of an episode that was run again, two rows of four, under a title.

    Args:
        failure: What was logged.
        replay: What it came to when it was run again; its own label is shown where it has one.

    Returns:
        Shape (height, width, 3).

    Raises:
        HomeError: If no picture can be drawn on this machine.
    """
    record, found = (failure.record, failure.label) if replay.label is None else (replay.record, replay.label)
    condition, episode = condition_of(record, found), replay.log.episode
    taken = moments(replay, found, condition)
    views = [_view(replay, found, condition, step) for step in taken]
    states, pictures = [replay.states[step] for step in taken], []
    mark = goal_marks(episode)[found.target]
    with RenderScene(episode, failure.record.eval_seed) as double, Studio(double.lane, SIZE) as studio:
        shots = _Camera(double).shots(states, [points for points, _ in views], found.target)
        for (step, note), state, shot, (_, measure) in zip(taken.items(), states, shots, views, strict=True):
            double.put(state)
            told = _tell(replay, step, note or measure)
            pictures.append(write_strip(studio.take(shot, [mark]), told, 1.0))
    title = f"{record.task} {record.split} {record.index:03d}, {record.arm}: {failure.words(replay.label)}"
    caption = _caption(replay, found, condition)
    if replay.label != failure.label:
        caption = f"the logs have another label for it: {failure.words(failure.label)}"
    return write_title(tile(pictures, COLUMNS), title, caption)


def _view(replay: Replay, found: Label, condition: Predicate | None, step: int) -> tuple[FloatArray, str]:
    """What a picture is about: two points of the room in [m], shape (2, 3), and how things stand between them."""
    episode, facts, gripper = replay.log.episode, replay.log.facts, replay.log.gripper[step]
    thing, name = facts.object_positions[step, found.target], found.stage if condition is None else condition.name
    if name.startswith(("at", "place", "not_holding")):
        goal = episode.goal_positions[found.target]
        return np.stack([thing, goal]), f"{np.linalg.norm(thing - goal):.2f} m from its goal"
    if name.startswith(("holding", "pick")):
        away = np.linalg.norm(thing - gripper)
        return np.stack([thing, gripper]), "in the hand" if facts.held[step] == found.target else f"{away:.2f} m away"
    containers = [episode.container(target) for target in range(len(episode.goals))]
    fridge = containers[found.target] == "top_door" if condition is None else name.endswith("fridge")
    link = "top_door" if fridge else next(each for each in containers if each not in (None, "top_door"))
    opened = max(float((facts.fridge if fridge else facts.drawer)[step]), 0.0)
    handle = np.array(episode.apartment().handle_to_room(str(link), opened))
    hand = float(np.linalg.norm(handle - gripper))
    words = f"{opened:.2f} {'rad' if fridge else 'm'} open"
    if hand > FAR_HAND:
        return np.stack([handle, handle]), words
    return np.stack([handle, gripper]), f"{words}, hand {hand:.2f} m"


def _tell(replay: Replay, step: int, words: str) -> Told:
    """What the strip below a picture says."""
    log, plan = replay.log, replay.log.episode.home_task.skills
    narrator, number = Narrator(log.episode), min(int(log.active[step]) + 1, len(plan))
    for _ in range(number):
        narrator.begins()
    told, stages = narrator.tell(), zip(log.episode.home_task.stages, stage_steps(replay.record), strict=True)
    skill = told.words if step < replay.record.steps else "settling"
    reached = tuple((stage.name, 0 <= when <= step) for stage, when in stages)
    return replace(told, seconds=(step + 1) / CONTROL_HZ, words=f"{skill}: {words}", stages=reached)


def _caption(replay: Replay, found: Label, condition: Predicate | None) -> str:
    """The numbers that the label was given for."""
    record = replay.record
    release = placement(record, found.target) if condition is not None and condition.name == "at" else None
    if release is not None:
        away, above = release_offset(record, release)
        lean, inside = float(tilt(release.track.up[0])), in_goal_since(record, release)
        stay = f"{inside.sum() / CONTROL_HZ:.1f} of {len(inside) / CONTROL_HZ:.1f} s"
        return (
            f"let go {above:.3f} m above and {away:.3f} m beside its place at {release.object_speed:.2f} m/s, "
            f"tilted by {lean:.0f} deg; in its goal {stay} after"
        )
    run = failed_run(record, found)
    if run is None:
        return "no skill ended"
    span = f"{run.begin / CONTROL_HZ:.1f} to {run.end / CONTROL_HZ:.1f} s"
    reach = f"; hand {run.reach:.3f} m away at best" if run.skill == "pick" else ""
    return f"{run.skill.replace('_', ' ')}: {span}, {run.ending}; largest contact force {run.force:.0f} N{reach}"


class _Camera(Follower):
    """Looks from one direction in all pictures of a sheet, the one from which most is seen."""

    def __init__(self, double: RenderScene) -> None:
        super().__init__(double.lane)
        self._double = double

    def shots(self, states: Sequence[FloatArray], points: Sequence[FloatArray], exclude: int) -> list[Shot]:
        """One for each state.

        Args:
            states: `qpos` of each picture. Shape (nq,).
            points: The two things to see in each, the more important one first. Shape (2, 3).
            exclude: Number of the object that does not hide itself.
        """
        scores = -0.4 * np.abs(DIRECTIONS[:, 1] - USUAL_ELEVATION)
        framings = []
        for state, pair in zip(states, points, strict=True):
            self._double.put(state)
            middle, apart = pair.mean(axis=0), float(np.linalg.norm(pair[0] - pair[1]))
            framings.append((middle, min(NEAR + ZOOM * apart, FAR)))
            eyes = [middle + framings[-1][1] * unit(*direction) for direction in DIRECTIONS]
            scores += [2.0 * self._sees(pair[0], eye, exclude) + self._sees(pair[1], eye, exclude) for eye in eyes]
        best = unit(*DIRECTIONS[int(np.argmax(scores))])
        return [Shot(middle + distance * best, middle) for middle, distance in framings]


def unit(azimuth: float, elevation: float) -> FloatArray:
    """The direction of angles in [rad]. Shape (3,)."""
    return np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])
