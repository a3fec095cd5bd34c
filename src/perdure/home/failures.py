"""Replays of failed episodes, and sheets of eight pictures that show the cause of a failure.

A failed episode of a log runs again with the same policies and settings. Its pictures let a reader check the label by
eye.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from perdure.errors import PerdureError
from perdure.film import GRAY, INK, Picture, Row, annotate, tile
from perdure.home.evaluate import outcomes
from perdure.home.evaluate.files import POLICIES, read_log_files, read_note
from perdure.home.evaluate.log import EpisodeLog, History, Release, SkillRun
from perdure.home.evaluate.outcomes import REST_MOVE, Counting, Label
from perdure.home.evaluate.protocol import EvaluationProtocol, noted_protocol
from perdure.home.film import SMALL, TITLE, Agent, caption, record, skill_words
from perdure.home.pictures import Follower, Studio, goal_marks, put, render_scene
from perdure.home.sim.arrays import FloatArray
from perdure.home.sim.pieces import CONTAINERS
from perdure.home.sim.scene import CONTROL_HZ
from perdure.home.skills import SKILLS
from perdure.home.tasks.episodes import Episode, episode_hash, load_episodes
from perdure.home.tasks.planners import needed_skills
from perdure.home.tasks.tasks import AT, NOTHING, PAST, Predicate, Verb, get_task
from perdure.report.charts import slug

PICTURES = 8
BEFORE = CONTROL_HZ
"""Steps before a release at which the first picture is taken: 1 s."""
NEARBY = 2.0 * AT
"""Moments after a release are spaced by the object's way while it is so near to its goal in [m] ..."""
PACE = 0.002
"""... and by time, of which a second counts as much as a way of 2 mm: an object that rests uses up few pictures."""
COLUMNS = 4
"""Pictures side by side on a sheet."""
SIZE = (480, 320)
"""Width and height of a picture in pixels, without the strip below."""
FAR_HAND = 1.5
"""A hand farther from a handle than this in [m] is not shown."""


@dataclass(frozen=True)
class Logged:
    """An episode of some logs that can run again."""

    log: EpisodeLog
    counting: Counting
    protocol: EvaluationProtocol
    """What was run, from the notes of the logs."""
    policies: tuple[tuple[str, str], ...] = ()
    """The policy of each skill, as the notes of the logs name it."""

    @property
    def label(self) -> Label | None:
        """Why it failed; None for a success."""
        return outcomes.label(self.log, self.counting)

    @cached_property
    def episode(self) -> Episode:
        """The episode; PerdureError when this package has another one, or none, under its number."""
        log = self.log
        episode = load_episodes(log.task, log.split)[log.index]
        if episode_hash(episode) != log.episode_hash:
            raise PerdureError(f"{log.name} is not the episode that this package has under that number")
        return episode

    def agent(self, policies: Mapping[str, str]) -> Agent:
        """Return the agent that acted when it was logged, with the settings of the log.

        Args:
            policies: Skill to file or "oracle", in place of what the logs name.

        Raises:
            PerdureError: If the release strategy is another simulator's, or a policy file is missing or has changed.
        """
        log = self.log
        given = self.protocol.options
        # The logs may be of several tasks: a policy replaces that of the tasks whose plans use its skill.
        elsewhere = SKILLS.keys() - set(needed_skills(get_task(log.task), given.planner))
        named = {skill: path for skill, path in policies.items() if skill not in elsewhere}
        settle = log.length - log.steps
        if log.diverged:
            settle = given.settle_steps
        options = replace(given, eval_seed=log.eval_seed, settle_steps=settle)
        protocol = replace(self.protocol, policies={**self.protocol.policies, **named}, options=options)
        agent = Agent(protocol, log.train_seed)
        for skill, name in self.policies:
            now = agent.policies[skill].name
            if now != name and skill not in named:
                raise PerdureError(
                    f"{skill} of these logs was {name}, and is {now} now: --policies {skill}=FILE names one"
                )
        return agent

    def words(self, found: Label | None) -> str:
        """Return a label of this episode as text, such as `place_1, rolled, 013_apple`."""
        if found is None:
            return "no failure"
        return f"{found.stage.name}, {found.cause}, {self.log.targets[found.target].kind}"

    @property
    def file_name(self) -> str:
        """Such as `set_table-val-ik-drag-train-0-eval-0-003.png`."""
        log = self.log
        seeds = f"train-{log.train_seed}-eval-{log.eval_seed}"
        return f"{log.task}-{log.split}-{slug(log.strategy.name)}-{seeds}-{log.index:03d}.png"


def read_logged(
    paths: Sequence[str | os.PathLike[str]],
    counting: Counting = "stabilizing",
    wanted: Callable[[EpisodeLog], bool] | None = None,
) -> list[Logged]:
    """Return the wanted episodes of log files, those that failed when None, in the order of `EpisodeLog.key`.

    Raises:
        PerdureError: A file holds no logs, an episode is there twice, or cannot be replayed by this package.
    """

    def failed(log: EpisodeLog) -> bool:
        return outcomes.label(log, counting) is not None

    found = []
    for logs, notes, path in read_log_files(paths):
        chosen = list(filter(wanted or failed, logs))
        if chosen:
            protocol = noted_protocol(notes, path)
            policies = tuple(read_note(notes, "policies", POLICIES).items())
            found += [Logged(log, counting, protocol, policies) for log in chosen]
    return sorted(found, key=lambda each: each.log.key)


def sample_failures(failures: Sequence[Logged], count: int, seed: int) -> list[Logged]:
    """Return `count` failures drawn at random without replacement; all when there are fewer. `seed` fixes the draw."""
    for name, value, least in (("count", count, 1), ("seed", seed, 0)):
        if value < least:
            raise PerdureError(f"{name} must be {least} or more, not {value}")
    return [failures[int(k)] for k in np.random.default_rng(seed).permutation(len(failures))[:count]]


@dataclass(frozen=True)
class Replay:
    """An episode that was run again."""

    log: EpisodeLog
    """With its history."""
    label: Label | None
    """Why it failed this time, None when it succeeded."""
    states: FloatArray
    """MuJoCo's `qpos` after every step. Shape (steps + settling time, nq)."""

    @property
    def history(self) -> History:
        """Every pose at every step."""
        assert self.log.history is not None
        return self.log.history


def replay_failure(failure: Logged, agent: Agent) -> Replay:
    """Run an episode again with the settings of its log."""
    frames, again = record(failure.episode, agent)
    return Replay(again, outcomes.label(again, failure.counting), np.array([frame.state for frame in frames]))


def picture_steps(replay: Replay, found: Label) -> dict[int, str]:
    """Return the steps to show, in order, each with a note on what happens there; fillers have an empty note."""
    log = replay.log
    release = _judged_release(log, found)
    way = np.arange(float(log.length))
    if log.diverged:
        keys = {max(0, log.length - 2 * CONTROL_HZ): "", log.length - 1: "diverges"}
    elif release is not None:
        keys, way = _after_release(replay, release)
        placed = log.run(Verb.PLACE, found.target)
        if placed and found.cause == "collision":
            keys |= _hardest(replay.history, placed)
    else:
        keys = _in_run(replay, found)
    return {step: keys.get(step, "") for step in _fill(sorted(keys), way)}


def _judged_release(log: EpisodeLog, found: Label) -> Release | None:
    """Return the release whose placement failed; None where something else failed."""
    if found.condition is None or found.condition.name != "at":
        return None
    return outcomes.placement(log, found.target)


def _after_release(replay: Replay, release: Release) -> tuple[dict[int, str], FloatArray]:
    """Return the steps to show of a placement, and a measure of progress at each step. Shape (steps,)."""
    log = replay.log
    start = release.step
    end = min(int(release.track.step[-1]) + CONTROL_HZ, log.length - 1)
    position = replay.history.facts.object_positions[: log.length, release.target]
    moving = np.flatnonzero(np.linalg.norm(position[start:end] - position[end], axis=1) > REST_MOVE)
    rest = min(start + max(CONTROL_HZ, int(moving.max(initial=-1)) + 1), end)
    inside = outcomes.in_goal_since(log, release)
    left = [start + 1 + int(k) for k in np.flatnonzero(inside[:-1] & ~inside[1:])[-1:]]
    keys = {max(0, start - BEFORE): "", start: "releases", **dict.fromkeys(left, "left its goal")}
    near = np.linalg.norm(position - log.targets[release.target].goal, axis=1) < NEARBY
    pace = np.linalg.norm(np.diff(position, axis=0), axis=1) * near[1:] + PACE / CONTROL_HZ
    pace[:start] = 0.0
    return keys | {rest: keys.get(rest, "")}, np.concatenate([[0.0], np.cumsum(pace)])


def _in_run(replay: Replay, found: Label) -> dict[int, str]:
    """Return the first and the last step of the skill that failed, and the step of its failure cause."""
    log = replay.log
    history = replay.history
    condition = found.condition
    run = failed_run(log, found)
    last = log.steps - 1
    begin = last
    if run is not None:
        last = max(run.end - 1, 0)
        begin = run.begin
    first = max(0, min(last - BEFORE, begin))
    keys = {first: "", last: ""}
    steps = slice(first, last + 1)
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
        undone = f"no longer {condition.name}"
        for step in (1 + np.flatnonzero(holds[:-1] & ~holds[1:])[-1:]).tolist():
            keys[max(0, step - BEFORE)] = ""
            keys[step] = undone
    return keys


def _hardest(history: History, run: SkillRun) -> dict[int, str]:
    """Return the step of the largest contact force in a run."""
    step = run.begin + int(np.argmax(history.force[run.begin : max(run.end, run.begin + 1)]))
    return {step: f"largest force, {history.force[step]:.0f} N"}


def _its_own(log: EpisodeLog, found: Label, condition: Predicate) -> bool:
    """Return whether the stage's own skill establishes a condition; otherwise something undid it."""
    container = log.targets[found.stage.target].container
    return condition.name == PAST[found.stage.verb] and condition.container == container


def failed_run(log: EpisodeLog, found: Label) -> SkillRun | None:
    """Return the run of the label's skill, or its navigation if that collided harder; else the last run."""
    run = log.run(found.stage.verb, found.stage.target)
    if run is None:
        return log.runs[-1] if log.runs else None
    if found.cause != "collision":
        return run
    ways = [r for r in log.runs if r.skill == Verb.NAVIGATE and r.target == run.target and r.end <= run.begin]
    return max((run, *ways[-1:]), key=lambda each: each.force)


def _fill(keys: Sequence[int], way: FloatArray) -> list[int]:
    """Return up to `PICTURES` steps: `keys`, and others that halve the longest stretch of `way` between two of them."""
    steps = list(keys)
    while len(steps) < PICTURES and (np.diff(steps) > 1).any():
        k = int(np.argmax(np.where(np.diff(steps) > 1, np.diff(way[steps]), -1.0)))
        middle = int(np.searchsorted(way, 0.5 * (way[steps[k]] + way[steps[k + 1]])))
        steps.insert(k + 1, min(max(middle, steps[k] + 1), steps[k + 1] - 1))
    return steps


def failure_sheet(failure: Logged, replay: Replay) -> Picture:
    """Return the pictures of a replay, two rows of four, under a title. Shape (height, width, 3).

    The replay's own label is shown where it has one.

    Raises:
        PerdureError: If no picture can be drawn on this machine.
    """
    log = replay.log
    found = replay.label
    if found is None:
        log = failure.log
        found = failure.label
    assert found is not None

    # The pictures, all from the one direction that shows them best.
    episode = failure.episode
    taken = picture_steps(replay, found)
    views = [_view(episode, replay, found, step) for step in taken]
    states = [replay.states[step] for step in taken]
    pictures = []
    marks = [goal_marks(episode)[found.target]]
    simulator = render_scene(episode, failure.log.eval_seed)
    with Studio(simulator, SIZE) as studio:
        pairs = [points for points, _ in views]
        shots = Follower(simulator).fixed(states, pairs, found.target)
        for (step, note), state, shot, (_, measure) in zip(taken.items(), states, shots, views, strict=True):
            put(simulator, state)
            below = _step_caption(episode, replay, step, note or measure)
            pictures.append(annotate(studio.take(shot, marks), (), below))

    # What is written above them.
    title = f"{log.task} {log.split} {log.index:03d}, {log.strategy.name}: {failure.words(replay.label)}"
    numbers = _numbers(replay, found)
    if replay.label != failure.label:
        numbers = f"the logs have another label for it: {failure.words(failure.label)}"
    above: list[Row] = [(2 * TITLE, [(title, INK)]), (2 * SMALL, [(numbers, GRAY)])]
    return annotate(tile(pictures, COLUMNS), above)


def _view(episode: Episode, replay: Replay, found: Label, step: int) -> tuple[FloatArray, str]:
    """Return two points to show in [m], shape (2, 3), and the measure between them as text."""
    facts = replay.history.facts
    gripper = replay.history.gripper[step]
    condition = found.condition
    thing = facts.object_positions[step, found.target]
    about: str = found.stage.verb
    if condition is not None:
        about = condition.name
    if about in ("at", "not_holding", Verb.PLACE):
        goal = episode.goal_positions[found.target]
        return np.stack([thing, goal]), f"{np.linalg.norm(thing - goal):.2f} m from its goal"
    if about in ("holding", Verb.PICK):
        words = f"{np.linalg.norm(thing - gripper):.2f} m away"
        if facts.held[step] == found.target:
            words = "in the hand"
        return np.stack([thing, gripper]), words
    name = replay.log.targets[found.target].container
    if condition is not None and condition.container is not None:
        name = condition.container
    opened = max(float(facts.containers[name][step]), 0.0)
    handle = np.array(episode.apartment().handle_to_room(str(episode.container_links()[name]), opened))
    hand = float(np.linalg.norm(handle - gripper))
    words = f"{opened:.2f} {CONTAINERS[name].unit} open"
    if hand > FAR_HAND:
        return np.stack([handle, handle]), words
    return np.stack([handle, gripper]), f"{words}, hand {hand:.2f} m"


def _step_caption(episode: Episode, replay: Replay, step: int, words: str) -> list[Row]:
    """Return the text of the strip below a picture."""
    log = replay.log
    run = log.run_at(step)
    begun = sum(each.begin <= step for each in log.runs)
    stages = zip(episode.home_task.stages, outcomes.stage_steps(log), strict=True)
    skill = "after the plan"
    if run is not None:
        skill = skill_words(episode, run)
    reached = tuple((stage.name, 0 <= when <= step) for stage, when in stages)
    return caption(f"{skill}: {words}", f"skill {begun}    {(step + 1) / CONTROL_HZ:.1f} s", reached)


def _numbers(replay: Replay, found: Label) -> str:
    """Return the measurements behind the label as text."""
    log = replay.log
    release = _judged_release(log, found)
    if release is not None:
        away, above = outcomes.release_offset(log, release)
        lean = float(outcomes.tilt(release.track.up[0]))
        inside = outcomes.in_goal_since(log, release)
        stay = f"{inside.sum() / CONTROL_HZ:.1f} of {len(inside) / CONTROL_HZ:.1f} s"
        return (
            f"released {above:.3f} m above and {away:.3f} m beside its goal at {release.object_speed:.2f} m/s, "
            f"tilted by {lean:.0f} deg; in its goal {stay} after"
        )
    run = failed_run(log, found)
    if run is None:
        return "no skill ended"
    span = f"{run.begin / CONTROL_HZ:.1f} to {run.end / CONTROL_HZ:.1f} s"
    reach = ""
    if run.skill == Verb.PICK:
        reach = f"; hand {run.reach:.3f} m away at best"
    return f"{run.skill.replace('_', ' ')}: {span}, {run.ending}; largest contact force {run.force:.0f} N{reach}"
