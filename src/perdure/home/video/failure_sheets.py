"""Sheets of eight pictures that show the cause of a failure, so that its label can be checked by eye.

The pictures are rendered from a copy of the scene, set to the states of a replay.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import product

import numpy as np

from perdure.home.benchmark.episodes import Episode
from perdure.home.benchmark.tasks import Predicate
from perdure.home.evaluate.outcomes import Label, placement
from perdure.home.evaluate.outcomes.counting import stage_steps
from perdure.home.evaluate.outcomes.failure_causes import in_goal_since, release_offset, tilt
from perdure.home.sim.apartments import FRIDGE_DOOR
from perdure.home.sim.arrays import FloatArray, Picture
from perdure.home.sim.world import CONTROL_HZ
from perdure.home.video.cameras import Shot
from perdure.home.video.film import tile
from perdure.home.video.follow import Follower, direction_of
from perdure.home.video.marks import goal_marks
from perdure.home.video.narrate import Caption, Narrator
from perdure.home.video.picture_steps import condition_of, failed_run, picture_steps
from perdure.home.video.render_scene import put, render_scene
from perdure.home.video.replay import Failure, Replay
from perdure.home.video.studio import Studio
from perdure.home.video.words import write_strip, write_title

COLUMNS, SIZE = 4, (480, 320)
"""Of one sheet; width and height of a picture in pixels, without the strip below."""
DIRECTIONS = np.array(list(product(np.arange(24) * (np.pi / 12.0), np.radians([12.0, 24.0, 36.0, 50.0, 65.0]))))
"""Azimuths and elevations of the camera that are tried, in [rad]."""
USUAL_ELEVATION = np.radians(36.0)
FAR_HAND = 1.5
"""A hand farther from a handle than this in [m] is not shown."""
NEAR, ZOOM, FAR = 1.3, 1.7, 4.5
"""The camera is NEAR + ZOOM * (distance of the two things it looks at) away, FAR at most, in [m]."""


def failure_sheet(failure: Failure, replay: Replay) -> Picture:
    """Return the pictures of a replay, two rows of four, under a title. Shape (height, width, 3).

    The replay's own label is shown where it has one.

    Raises:
        RenderError: If no picture can be drawn on this machine.
    """
    log, found = (failure.log, failure.label) if replay.label is None else (replay.log, replay.label)
    condition, episode = condition_of(log, found), failure.episode
    taken = picture_steps(replay, found, condition)
    views = [_view(episode, replay, found, condition, step) for step in taken]
    states, pictures = [replay.states[step] for step in taken], []
    mark = goal_marks(episode)[found.target]
    simulator = render_scene(episode, failure.log.eval_seed)
    with Studio(simulator, SIZE) as studio:
        shots = _Camera(simulator).shots(states, [points for points, _ in views], found.target)
        for (step, note), state, shot, (_, measure) in zip(taken.items(), states, shots, views, strict=True):
            put(simulator, state)
            caption = _step_caption(episode, replay, step, note or measure)
            pictures.append(write_strip(studio.take(shot, [mark]), caption, 1.0))
    title = f"{log.task} {log.split} {log.index:03d}, {log.strategy}: {failure.words(replay.label)}"
    numbers = _numbers(replay, found, condition)
    if replay.label != failure.label:
        numbers = f"the logs have another label for it: {failure.words(failure.label)}"
    return write_title(tile(pictures, COLUMNS), title, numbers)


def _view(
    episode: Episode, replay: Replay, found: Label, condition: Predicate | None, step: int
) -> tuple[FloatArray, str]:
    """Return two points to show in [m], shape (2, 3), and the measure between them as text."""
    facts, gripper = replay.history.facts, replay.history.gripper[step]
    thing, name = facts.object_positions[step, found.target], found.stage if condition is None else condition.name
    if name.startswith(("at", "place", "not_holding")):
        goal = episode.goal_positions[found.target]
        return np.stack([thing, goal]), f"{np.linalg.norm(thing - goal):.2f} m from its goal"
    if name.startswith(("holding", "pick")):
        away = np.linalg.norm(thing - gripper)
        return np.stack([thing, gripper]), "in the hand" if facts.held[step] == found.target else f"{away:.2f} m away"
    containers = [episode.container(target) for target in range(len(episode.goals))]
    fridge = containers[found.target] == FRIDGE_DOOR if condition is None else name.endswith("fridge")
    link = FRIDGE_DOOR if fridge else next(each for each in containers if each not in (None, FRIDGE_DOOR))
    opened = max(float((facts.fridge if fridge else facts.drawer)[step]), 0.0)
    handle = np.array(episode.apartment().handle_to_room(str(link), opened))
    hand = float(np.linalg.norm(handle - gripper))
    words = f"{opened:.2f} {'rad' if fridge else 'm'} open"
    if hand > FAR_HAND:
        return np.stack([handle, handle]), words
    return np.stack([handle, gripper]), f"{words}, hand {hand:.2f} m"


def _step_caption(episode: Episode, replay: Replay, step: int, words: str) -> Caption:
    """Return the text of the strip below a picture."""
    log, plan = replay.log, episode.home_task.skills
    begun = min(int(log.active[min(step, log.length - 1)]) + 1, len(plan))
    caption, stages = Narrator(episode, begun).caption(), zip(episode.home_task.stages, stage_steps(log), strict=True)
    skill = caption.words if step < log.steps else "settling"
    reached = tuple((stage.name, 0 <= when <= step) for stage, when in stages)
    return replace(caption, seconds=(step + 1) / CONTROL_HZ, words=f"{skill}: {words}", stages=reached)


def _numbers(replay: Replay, found: Label, condition: Predicate | None) -> str:
    """Return the measurements behind the label as text."""
    log = replay.log
    release = placement(log, found.target) if condition is not None and condition.name == "at" else None
    if release is not None:
        away, above = release_offset(log, release)
        lean, inside = float(tilt(release.track.up[0])), in_goal_since(log, release)
        stay = f"{inside.sum() / CONTROL_HZ:.1f} of {len(inside) / CONTROL_HZ:.1f} s"
        return (
            f"released {above:.3f} m above and {away:.3f} m beside its goal at {release.object_speed:.2f} m/s, "
            f"tilted by {lean:.0f} deg; in its goal {stay} after"
        )
    run = failed_run(log, found)
    if run is None:
        return "no skill ended"
    span = f"{run.begin / CONTROL_HZ:.1f} to {run.end / CONTROL_HZ:.1f} s"
    reach = f"; hand {run.reach:.3f} m away at best" if run.skill == "pick" else ""
    return f"{run.skill.replace('_', ' ')}: {span}, {run.ending}; largest contact force {run.force:.0f} N{reach}"


class _Camera(Follower):
    """A camera with one direction for all pictures of a sheet, the one with the fewest occlusions."""

    def shots(self, states: Sequence[FloatArray], points: Sequence[FloatArray], exclude: int) -> list[Shot]:
        """Return a shot for each state (nq,) that shows two points (2, 3), the more important one first.

        `exclude` is the number of the object that does not hide itself.
        """
        scores = -0.4 * np.abs(DIRECTIONS[:, 1] - USUAL_ELEVATION)
        framings = []
        for state, pair in zip(states, points, strict=True):
            put(self._simulator, state)
            middle, apart = pair.mean(axis=0), float(np.linalg.norm(pair[0] - pair[1]))
            framings.append((middle, min(NEAR + ZOOM * apart, FAR)))
            eyes = [middle + framings[-1][1] * direction_of(*direction) for direction in DIRECTIONS]
            scores += [2.0 * self._sees(pair[0], eye, exclude) + self._sees(pair[1], eye, exclude) for eye in eyes]
        best = direction_of(*DIRECTIONS[int(np.argmax(scores))])
        return [Shot(middle + distance * best, middle) for middle, distance in framings]
