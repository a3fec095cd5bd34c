"""The log of an episode: what was run, what happened when, and where objects went after their release.

The executor's recorder makes it, `files` writes and reads it, `outcomes` judges it. Step 0 is the state after the first
control step. A skill run that begins at 10 and ends at 25 has acted in steps 10 to 24. The state at a release is that
of the last step in which the object was held.

Each class is a part of the file's table: a field with a `Column` is a column of it. A new column is a new field.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Annotated, Literal, get_args

import numpy as np

from perdure.errors import PerdureError
from perdure.home.evaluate.strategy import CALM, Strategy
from perdure.home.sim.arrays import BoolArray, FloatArray, IntArray, Vec3
from perdure.home.sim.pieces import CONTAINERS
from perdure.home.tasks.tasks import (
    ABOUT_CONTAINERS,
    SKILL_VERBS,
    TASKS,
    HomeTask,
    Predicate,
    Verb,
    WorldFacts,
    at,
    get_task,
)
from perdure.schema import Choice, Flag, Kind, Real, Text, Whole

UNTRAINED = -1
"""Training seed where no policy was trained."""
Ending = Literal["stopped", "timed out", "task limit"]
"""Why a skill run ended: its own stop rule, its step limit, or the task's step limit."""
ENDINGS: tuple[Ending, ...] = get_args(Ending)
MOVED = 0.002
TURNED = 0.01
"""Tracks leave out steps at which the object is within 2 mm of where it was, the height of its z axis within 0.01."""
TOUCH_SECONDS = 2.0
"""Time after a release in which touches are counted: the hand withdraws."""
GRID = 2.0**-13
"""Poses of tracks are rounded to multiples of this (0.12 mm), which lets a file shrink."""


@dataclass(frozen=True)
class Column:
    """A column of the file's table: what it holds, and what its values may be."""

    about: str
    kind: Kind | None = None
    """Of one value; None: a part with columns of its own."""
    unit: str = ""
    names: tuple[str, ...] = ()
    """Of the columns, where a vector has one for each component; else the column is named as the field."""
    narrow: bool = False
    """Whether 32 bits are enough."""
    shortest: int = 0
    """Of a list."""
    longest: int = 10_000_000


_XYZ = ("x", "y", "z")
_QUATERNION = ("qw", "qx", "qy", "qz")
_NAME = Text(200, shortest=1)
_WORDS = Text(200)
_FLAG = Flag()
_SEED = Whole(-1)
_STEP = Whole(0, 1_000_000)
_TARGET = Whole(0, 100)
_PLACE = Real(-1e9, 1e9)
"""A simulation that blows up throws objects far."""
_UNIT = Real(-1.001, 1.001)
_MEASURED = Real(0.0, unknown=True)


@dataclass(frozen=True)
class Target:
    """A target object and its goal."""

    kind: Annotated[str, Column("YCB name", _NAME)]
    cylinder: Annotated[bool, Column("whether it is an upright cylinder (a can)", _FLAG)]
    container: Annotated[str, Column('container it starts in, such as "drawer", or ""', Choice(("", *CONTAINERS)))]
    goal: Annotated[
        Vec3, Column("goal of its middle, at rest and upright", _PLACE, "m", ("goal_x", "goal_y", "goal_z"))
    ]


@dataclass(frozen=True)
class SkillRun:
    """One skill, as it was executed."""

    skill: Annotated[str, Column("name of the skill", _NAME)]
    target: Annotated[int, Column("number of its target", _TARGET)]
    attempt: Annotated[int, Column("attempt, from 1; of the next skill for navigate", Whole(1, 10_000))]
    toward: Annotated[str, Column("for navigate: the skill that follows; else empty", Text(200))]
    scripted: Annotated[bool, Column("whether the oracle acted, in place of a policy", _FLAG)]
    begin: Annotated[int, Column("control steps of the episode before it", _STEP)]
    end: Annotated[int, Column("control steps of the episode at its end", _STEP)]
    ending: Annotated[Ending, Column('"stopped", "timed out" or "task limit"', Choice(ENDINGS))]
    success: Annotated[bool, Column("whether its own success condition held in its last step", _FLAG)]
    forced_release: Annotated[bool, Column("whether the executor opened the hand after a time-out", _FLAG)]
    force: Annotated[
        float,
        Column("largest normal contact force at arm, hand and held object, not the base; nan: unknown", _MEASURED, "N"),
    ] = math.nan
    reach: Annotated[
        float, Column("smallest distance of the gripper point from the target's middle; nan: unknown", _MEASURED, "m")
    ] = math.nan


@dataclass(frozen=True)
class ContainerPosition:
    """How far a container is open."""

    name: Annotated[str, Column("container, such as fridge", Choice(tuple(CONTAINERS)))]
    position: Annotated[float, Column("how far it is open; 0 where the task has none", Real(-10.0, 10.0), "m or rad")]


@dataclass(frozen=True)
class Event:
    """The inputs of the stages' conditions, from this step to the next event.

    An event is due at step 0 and whenever `held`, a member of `in_goal`, or whether a container counts as open or as
    closed changes (`data/furniture.json` has the limits of each). A grasp is an event at which `held` becomes a target,
    a release one at which it ceases to be it.
    """

    step: Annotated[int, Column("first step of this state", _STEP)]
    held: Annotated[int, Column("target in the hand; -1: nothing; -2: clutter or a handle", Whole(-2, 100))]
    in_goal: Annotated[tuple[bool, ...], Column("which targets are within 0.15 m of their goals", _FLAG, longest=100)]
    containers: Annotated[tuple[ContainerPosition, ...], Column("how far containers are open", longest=100)]

    @cached_property
    def positions(self) -> Mapping[str, float]:
        """How far each container is open in [m] or [rad], by name."""
        return {each.name: each.position for each in self.containers}


@dataclass(frozen=True)
class Track:
    """The path of an object. Steps at which it had hardly moved since the last kept one are left out.

    Raises:
        PerdureError: If there are no steps, they are out of order, or lengths differ.
    """

    step: Annotated[IntArray, Column("steps", _STEP, narrow=True, shortest=1)]
    """Shape (n,)."""
    position: Annotated[FloatArray, Column("middle of the object", _PLACE, "m", _XYZ, narrow=True)]
    """Shape (n, 3)."""
    up: Annotated[FloatArray, Column("height of its own z axis: 1 upright, 0 lying", _UNIT, narrow=True)]
    """Shape (n,)."""
    gripper: Annotated[
        FloatArray, Column("gripper point", _PLACE, "m", ("gripper_x", "gripper_y", "gripper_z"), narrow=True)
    ]
    """Shape (n, 3)."""
    base: Annotated[
        FloatArray, Column("base, heading in [rad]", _PLACE, "m", ("base_x", "base_y", "base_yaw"), narrow=True)
    ]
    """Shape (n, 3)."""

    def __post_init__(self) -> None:
        n = len(self.step)
        lengths = {len(each) for each in (self.position, self.up, self.gripper, self.base)}
        if n == 0 or lengths != {n} or (np.diff(self.step) <= 0).any():
            raise PerdureError(
                f"a track needs rising steps and as many poses; it has {n} steps, {sorted(lengths)} poses"
            )

    @cached_property
    def thin(self) -> Track:
        """Without the steps at which the object had hardly moved.

        Causes look at nothing else, so that logs which keep every step are judged alike.
        """
        rows = kept_steps(self.position, self.up)
        return Track(self.step[rows], self.position[rows], self.up[rows], self.gripper[rows], self.base[rows])

    def rows(self, first: int, last: int) -> IntArray:
        """Return the row of the track for each step from `first` to `last`, both included."""
        return np.searchsorted(self.step, np.arange(first, last + 1), side="right") - 1


@dataclass(frozen=True)
class Release:
    """The release of a target, with the speeds at that step."""

    target: Annotated[int, Column("number of the target", _TARGET)]
    object_speed: Annotated[float, Column("speed of the object in the hand", _MEASURED, "m/s")]
    gripper_speed: Annotated[float, Column("speed of the gripper point", _MEASURED, "m/s")]
    base_speed: Annotated[float, Column("speed of the base's middle, turning left out", _MEASURED, "m/s")]
    track: Annotated[
        Track, Column("from the last step in the hand to the end, or to the step before the hand takes it again")
    ]
    touches: Annotated[
        int, Column("steps of the two seconds after it in which arm or hand touched the object; -1: unknown", Whole(-1))
    ] = -1
    pushed: Annotated[
        float, Column("way of the object's middle in these steps, in the plane; nan: unknown", _MEASURED, "m")
    ] = math.nan

    @property
    def step(self) -> int:
        """Last step in the hand."""
        return int(self.track.step[0])


@dataclass(frozen=True)
class FinalObject:
    """An object after the last step, target or clutter."""

    kind: Annotated[str, Column("YCB name", _NAME)]
    position: Annotated[Vec3, Column("its middle in the room", _PLACE, "m", _XYZ, narrow=True)]
    quaternion: Annotated[
        tuple[float, float, float, float],
        Column("attitude of its frame in the room", _UNIT, names=_QUATERNION, narrow=True),
    ]
    speed: Annotated[float, Column("speed", Real(0.0), "m/s", narrow=True)]
    held: Annotated[bool, Column("whether it is in the hand", _FLAG)]


@dataclass(frozen=True, eq=False)
class EpisodeLog:
    """The log of one executed episode; any simulator can make one.

    Two logs are equal only if they are the same object, so that counts can be cached with a log.

    Raises:
        PerdureError: With the log's name, if it contradicts itself.
    """

    task: Annotated[str, Column("name of the task", Choice(tuple(TASKS)))]
    split: Annotated[str, Column("such as val", Text(50, shortest=1))]
    index: Annotated[int, Column("number of the episode in its split", Whole(0, 1_000_000))]
    episode_hash: Annotated[str, Column("equal hashes: equal starts and goals (elsewhere: any name)", _NAME)]
    place: Annotated[str, Column('release strategy, or any text such as "TP+SRL"', _NAME)]
    train_seed: Annotated[int, Column("training seed; -1: nothing was trained", _SEED)]
    eval_seed: Annotated[int, Column("evaluation seed", _SEED)]
    control_hz: Annotated[float, Column("control steps per second", Real(0.0, 1e5, above=True), "1/s")]
    steps: Annotated[int, Column("control steps of the episode", Whole(1, 1_000_000))]
    length: Annotated[int, Column("control steps with the settling time after it", Whole(1, 1_000_000))]
    diverged: Annotated[bool, Column("whether the simulation diverged; nothing after the last step counts", _FLAG)]
    targets: Annotated[tuple[Target, ...], Column("target objects", longest=100)]
    runs: Annotated[tuple[SkillRun, ...], Column("skills in the order in which they ran")]
    events: Annotated[tuple[Event, ...], Column("of rising steps, the first at step 0", shortest=1)]
    releases: Annotated[tuple[Release, ...], Column("releases of targets")] = ()
    final_objects: Annotated[
        tuple[FinalObject, ...],
        Column("every object after the last step, targets first; empty: unknown", longest=10_000),
    ] = ()
    world: Annotated[str, Column("options that differ from the usual world, in words", _WORDS)] = ""
    planner: Annotated[str, Column("planner", _NAME)] = "open"
    fallback: Annotated[str, Column("who takes over a skill that failed often; none with the open loop", _NAME)] = (
        "none"
    )
    disturbance: Annotated[str, Column('disturbances that acted together, such as "bump:0.1"; none', _NAME)] = CALM
    label: str = ""
    """What `perdure home analyze --names` calls its file; files do not keep it."""
    history: History | None = field(default=None, repr=False)
    """Every pose at every step; files do not keep it."""
    drawn: HomeTask | None = field(default=None, repr=False)
    """The task as its episode has it, with the stages of an errand; None: as declared. Files do not keep it."""

    def __post_init__(self) -> None:
        for wrong in (*self._wrong_lengths(), *self._wrong_events(), *self._wrong_parts()):
            raise PerdureError(f"{self.name} does not fit together: it has {wrong}")

    def _wrong_lengths(self) -> Iterator[str]:
        if not self.place:
            yield "no place: it must name what was run"
        if self.steps < 1 or self.length < self.steps:
            yield f"{self.steps} steps of {self.length}"
        if not self.diverged and self.length == self.steps:
            yield "no settling time after its last step"
        if not self.control_hz > 0.0:
            yield f"a control rate of {self.control_hz} Hz"

    def _wrong_events(self) -> Iterator[str]:
        if not self.events or self.events[0].step != 0:
            yield "no event at step 0"
        if (np.diff(self._event_steps, append=self.length) <= 0).any():
            yield "events out of order"
        if any(len(event.in_goal) != len(self.targets) for event in self.events):
            yield "events about other targets"
        if any(event.held >= len(self.targets) for event in self.events):
            yield "a held target that is not there"
        if len({tuple(event.positions) for event in self.events}) > 1:
            yield "events about other containers"

    def _wrong_parts(self) -> Iterator[str]:
        if len(self.targets) != len(get_task(self.task).targets):
            yield f"{len(self.targets)} targets"
        about = [run.target for run in self.runs] + [release.target for release in self.releases]
        if any(not 0 <= target < len(self.targets) for target in about):
            yield "a run or release of an unknown target"
        if any(run.ending not in ENDINGS for run in self.runs):
            yield f"a run's ending that is none of {ENDINGS}"
        if any(not 0 <= run.begin <= run.end <= self.steps for run in self.runs):
            yield "runs outside its steps"
        containers = {""}
        if self.events:
            containers |= set(self.events[0].positions)
        if any(target.container not in containers for target in self.targets):
            yield "a container that its events lack"
        if any(release.track.step[-1] >= self.length for release in self.releases):
            yield "a track beyond its end"

    @cached_property
    def strategy(self) -> Strategy:
        """What was run."""
        return Strategy(self.place, self.world, self.planner, self.fallback, self.disturbance, self.label)

    @property
    def name(self) -> str:
        """Such as `TP+SRL, training seed 100, set_table/val/003, evaluation seed 0`."""
        episode = f"{self.task}/{self.split}/{self.index:03d}"
        return f"{self.strategy.name}, training seed {self.train_seed}, {episode}, evaluation seed {self.eval_seed}"

    @property
    def key(self) -> tuple[str, str, Strategy, int, int, int]:
        """What no two episodes of one analysis may share."""
        return self.task, self.split, self.strategy, self.train_seed, self.eval_seed, self.index

    @property
    def home_task(self) -> HomeTask:
        """The task it belongs to."""
        return self.drawn or get_task(self.task)

    @cached_property
    def _event_steps(self) -> list[int]:
        return [event.step for event in self.events]

    def at(self, step: int) -> Event:
        """Return the state at a step."""
        return self.events[bisect_right(self._event_steps, step) - 1]

    def run_at(self, step: int) -> SkillRun | None:
        """Return the skill that acted at a step, None if none did."""
        return next((run for run in self.runs if run.begin <= step < run.end), None)

    def run(self, verb: Verb, target: int) -> SkillRun | None:
        """Return the last run of a skill that does this for a target, None if it never ended."""
        found = [run for run in self.runs if SKILL_VERBS.get(run.skill) == verb and run.target == target]
        return found[-1] if found else None


def kept_steps(position: FloatArray, up: FloatArray) -> IntArray:
    """Return the steps a track keeps: first, last, and each at which the object has moved since the step kept before.

    `position` has shape (n, 3), `up` shape (n,).
    """
    points = position.tolist()
    heights = up.tolist()
    kept = [0]
    for step in range(1, len(points)):
        last = kept[-1]
        if math.dist(points[step], points[last]) > MOVED or abs(heights[step] - heights[last]) > TURNED:
            kept.append(step)
    if kept[-1] != len(points) - 1:
        kept.append(len(points) - 1)
    return np.array(kept)


@dataclass(frozen=True)
class History:
    """An episode and the settling time after it, step by step.

    Raises:
        PerdureError: If there are no steps, or arrays differ in length.
    """

    facts: WorldFacts
    """Targets, goals, held, containers. Leading axis (steps,)."""
    up: FloatArray
    """Height of the targets' own z axes: 1 upright, 0 lying. Shape (steps, targets)."""
    speed: FloatArray
    """Speed of the targets in [m/s]. Shape (steps, targets)."""
    gripper: FloatArray
    """Gripper point in the room in [m]. Shape (steps, 3)."""
    base: FloatArray
    """Base in the room: x, y, heading. Shape (steps, 3)."""
    force: FloatArray
    """Largest normal contact force at the robot in [N]; nan if unknown. Shape (steps,)."""
    control_hz: float
    touched: BoolArray | None = None
    """Whether arm or hand touched each target, while it was not held; None if unknown. Shape (steps, targets)."""

    def __post_init__(self) -> None:
        known = [
            each.name for each in fields(self) if each.name != "control_hz" and getattr(self, each.name) is not None
        ]
        lengths = {name: len(getattr(self, name)) for name in known}
        if len(set(lengths.values())) != 1 or not len(self.facts):
            raise PerdureError(f"a history needs as many steps of everything, and at least one; it has {lengths}")

    @property
    def events(self) -> tuple[Event, ...]:
        """The state at the first step, and at each step at which a condition of a stage may change."""
        facts = self.facts
        inside = at(facts)
        doors = [Predicate(state, container=name) for name in facts.containers for state in ABOUT_CONTAINERS]
        state = np.column_stack([facts.held, inside, *(door.holds(facts) for door in doors)]).astype(np.int64)
        changes = np.concatenate([[0], 1 + np.flatnonzero((state[1:] != state[:-1]).any(axis=1))])
        return tuple(
            Event(
                step=int(k),
                held=int(facts.held[k]),
                in_goal=tuple(map(bool, inside[k])),
                containers=tuple(ContainerPosition(name, float(q[k])) for name, q in facts.containers.items()),
            )
            for k in changes
        )

    @property
    def releases(self) -> tuple[Release, ...]:
        """Every release of a target, in order."""
        held = np.asarray(self.facts.held)
        let_go = np.flatnonzero((held[:-1] >= 0) & (held[1:] != held[:-1]))
        return tuple(self._release(int(step), int(held[step])) for step in let_go)

    def measured(self, run: SkillRun) -> SkillRun:
        """Return a skill run with the largest force and the smallest reach of its steps."""
        if run.end <= run.begin:
            return run
        steps = slice(run.begin, run.end)
        away = np.linalg.norm(self.gripper[steps] - self.facts.object_positions[steps, run.target], axis=1)
        return replace(run, force=float(self.force[steps].max()), reach=float(away.min()))

    def _release(self, step: int, target: int) -> Release:
        again = np.flatnonzero(self.facts.held[step + 1 :] == target)
        rows = slice(step, step + 1 + int(again[0]) if len(again) else len(self.facts))
        position = _rounded(self.facts.object_positions[rows, target])
        up = _rounded(self.up[rows, target])
        kept = kept_steps(position, up)
        before = max(step - 1, 0)
        touches, pushed = self._touches_after(step, rows.stop, target)
        return Release(
            target=target,
            object_speed=float(self.speed[step, target]),
            gripper_speed=float(np.linalg.norm(self.gripper[step] - self.gripper[before])) * self.control_hz,
            base_speed=float(np.linalg.norm(self.base[step, :2] - self.base[before, :2])) * self.control_hz,
            track=Track(
                step=step + kept,
                position=position[kept],
                up=up[kept],
                gripper=_rounded(self.gripper[rows][kept]),
                base=_rounded(self.base[rows][kept]),
            ),
            touches=touches,
            pushed=pushed,
        )

    def _touches_after(self, step: int, end: int, target: int) -> tuple[int, float]:
        """Return `Release.touches` and `Release.pushed` of a release at a step whose track ends before `end`."""
        if self.touched is None:
            return -1, math.nan
        steps = slice(step + 1, min(end, step + 1 + round(TOUCH_SECONDS * self.control_hz)))
        touched = self.touched[steps, target]
        middles = self.facts.object_positions[step : steps.stop, target, :2]
        ways = np.linalg.norm(np.diff(middles, axis=0), axis=1)
        return int(touched.sum()), float(ways[touched].sum())


def _rounded(values: FloatArray) -> FloatArray:
    return np.round(values / GRID) * GRID
