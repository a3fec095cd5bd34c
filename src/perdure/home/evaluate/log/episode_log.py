"""The log of an episode: what was run, what happened when, and where objects went after their release.

The executor's recorder makes it, `perdure.home.evaluate.outcomes` writes, reads and analyzes it. Step 0 is the state
after the first control step. A skill run that begins at 10 and ends at 25 has acted in steps 10 to 24. The state at a
release is that of the last step in which the object was held.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np

from perdure.home.benchmark.tasks import HomeTask, get_task
from perdure.home.errors import HomeError
from perdure.home.sim.arrays import FloatArray, IntArray, Vec3

if TYPE_CHECKING:
    from perdure.home.evaluate.log.history import History


UNTRAINED = -1
"""Training seed where no policy was trained."""
Ending = Literal["stopped", "timed out", "task limit"]
"""Why a skill run ended: its own stop rule, its step limit, or the task's step limit."""
ENDINGS: tuple[Ending, ...] = get_args(Ending)
CONTAINERS = ("", "drawer", "fridge")
"""Container of a target at the start: none, a drawer, the fridge."""


MOVED, TURNED = 0.002, 0.01
"""Tracks leave out steps at which the object is within 2 mm of where it was, the height of its z axis within 0.01."""


@dataclass(frozen=True)
class Target:
    """A target object and its goal."""

    kind: str
    """YCB name."""
    cylinder: bool
    """Whether it is an upright cylinder (a can)."""
    container: str
    """One of `CONTAINERS`."""
    goal: Vec3
    """Goal of the object's center, at rest and upright, in the room in [m]."""


@dataclass(frozen=True)
class SkillRun:
    """One skill of the plan, as it was executed."""

    number: int
    """Position in the plan, from 0."""
    skill: str
    target: int
    begin: int
    """Control steps of the episode before it."""
    end: int
    """Control steps of the episode at its end."""
    ending: Ending
    success: bool
    """Whether the skill's own success condition held in its last step."""
    forced_release: bool
    """Whether the executor opened the hand after a time-out."""
    force: float = math.nan
    """Largest normal contact force at the robot during it in [N]; nan if unknown."""
    reach: float = math.nan
    """Smallest distance of the gripper point from the target's middle during it in [m]; nan if unknown."""


@dataclass(frozen=True)
class Event:
    """The inputs of the stages' conditions, from this step to the next event."""

    step: int
    held: int
    """Number of the target in the hand, -1 when it is empty, -2 when it holds clutter or a handle."""
    in_goal: tuple[bool, ...]
    """Which targets are within 0.15 m of their goals."""
    drawer: float
    """How far the drawer of target 0 is out in [m]."""
    fridge: float
    """How far the fridge's upper door is open in [rad]."""


@dataclass(frozen=True)
class Track:
    """The path of an object. Steps at which it had hardly moved since the step before are left out."""

    step: IntArray
    """Shape (n,)."""
    position: FloatArray
    """Of the object's middle in [m]. Shape (n, 3)."""
    up: FloatArray
    """Height of its own z axis: 1 upright, 0 lying. Shape (n,)."""
    gripper: FloatArray
    """Gripper point in [m]. Shape (n, 3)."""
    base: FloatArray
    """Base: x, y, heading. Shape (n, 3)."""

    def __post_init__(self) -> None:
        """Lengths that differ, no steps, or steps out of order raise HomeError."""
        n = len(self.step)
        lengths = {len(each) for each in (self.position, self.up, self.gripper, self.base)}
        if n == 0 or lengths != {n} or (np.diff(self.step) <= 0).any():
            raise HomeError(f"a track needs rising steps and as many poses; it has {n} steps, {sorted(lengths)} poses")

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

    target: int
    object_speed: float
    """Measured in the hand, in [m/s]. A world that removes release velocity changes it afterwards."""
    gripper_speed: float
    base_speed: float
    """Of the base's middle, turning left out, in [m/s]."""
    track: Track
    """From the last step in the hand to the end, or to the step before the hand takes the object again."""

    @property
    def step(self) -> int:
        """Last step in the hand."""
        return int(self.track.step[0])


@dataclass(frozen=True)
class FinalObject:
    """An object after the last step, target or clutter."""

    kind: str
    """YCB name."""
    position: Vec3
    """Of its middle in the room in [m]."""
    quaternion: tuple[float, float, float, float]
    """Attitude of its frame in the room (w, x, y, z)."""
    speed: float
    """In [m/s]."""
    held: bool
    """Whether it is in the hand."""


@dataclass(frozen=True, eq=False)
class EpisodeLog:
    """The log of one executed episode. Stages and placements are counted from the events, see `outcomes.counting`.

    Two logs are equal only if they are the same object, so that counts can be cached with a log.
    """

    task: str
    split: str
    index: int
    episode_hash: str
    """SHA-256 of what the episode starts from: equal hashes are equal starts and goals."""
    strategy: str
    """Name of what was run, see `protocol.strategy_name`; of other simulators any text, such as "TP+SRL"."""
    train_seed: int
    """`UNTRAINED` where nothing was trained."""
    eval_seed: int
    control_hz: float
    steps: int
    """Control steps of the episode."""
    length: int
    """Control steps with the settling time after it."""
    diverged: bool
    """Whether the simulation diverged; nothing after the last step counts."""
    targets: tuple[Target, ...]
    runs: tuple[SkillRun, ...]
    events: tuple[Event, ...]
    """Of rising steps, the first at step 0."""
    releases: tuple[Release, ...] = field(default=())
    final_objects: tuple[FinalObject, ...] = field(default=())
    """All objects after the last step, targets first; empty where the writer did not keep them."""
    history: History | None = field(default=None, repr=False)
    """Every pose at every step; files do not keep it."""

    def __post_init__(self) -> None:
        """A log that contradicts itself raises HomeError with its name."""
        about = [*(run.target for run in self.runs), *(release.target for release in self.releases)]
        for wrong, sentence in (
            (not self.strategy, "no strategy: it must name what was run"),
            (len(self.targets) != len(get_task(self.task).targets), f"{len(self.targets)} targets"),
            (self.steps < 1 or self.length < self.steps, f"{self.steps} steps of {self.length}"),
            (not self.diverged and self.length == self.steps, "no settling time after its last step"),
            (not self.control_hz > 0.0, f"a control rate of {self.control_hz} Hz"),
            (not self.events or self.events[0].step != 0, "no event at step 0"),
            (_not_rising([e.step for e in self.events], self.length), "events out of order"),
            (any(len(e.in_goal) != len(self.targets) for e in self.events), "events about other targets"),
            (any(not 0 <= k < len(self.targets) for k in about), "a run or release of an unknown target"),
            (any(r.ending not in ENDINGS for r in self.runs), f"a run's ending that is none of {ENDINGS}"),
            (any(not 0 <= r.begin <= r.end <= self.steps for r in self.runs), "runs outside its steps"),
            (any(t.container not in CONTAINERS for t in self.targets), f"a container that is none of {CONTAINERS}"),
            (any(r.track.step[-1] >= self.length for r in self.releases), "a track beyond its end"),
        ):
            if wrong:
                raise HomeError(f"{self.name} does not fit together: it has {sentence}")

    @property
    def name(self) -> str:
        """Such as `TP+SRL, training seed 100, set_table/val/003, evaluation seed 0`."""
        episode = f"{self.task}/{self.split}/{self.index:03d}"
        return f"{self.strategy}, training seed {self.train_seed}, {episode}, evaluation seed {self.eval_seed}"

    @property
    def key(self) -> tuple[str, str, str, int, int, int]:
        """What no two episodes of one analysis may share."""
        return self.task, self.split, self.strategy, self.train_seed, self.eval_seed, self.index

    @property
    def home_task(self) -> HomeTask:
        """The task it belongs to."""
        return get_task(self.task)

    @property
    def active(self) -> IntArray:
        """Number of the plan's step that acted at each step; the plan's length while settling. Shape (length,)."""
        active = np.zeros(self.length, dtype=np.int64)
        for run in self.runs:
            active[run.begin : run.end], active[run.end :] = run.number, run.number + 1
        active[self.steps :] = len(self.home_task.skills)
        return active

    @cached_property
    def _event_steps(self) -> IntArray:
        return np.array([event.step for event in self.events])

    def at(self, step: int) -> Event:
        """Return the state at a step."""
        return self.events[int(np.searchsorted(self._event_steps, step, side="right")) - 1]

    def run(self, skill: str, target: int) -> SkillRun | None:
        """Return the first run of a skill (or of any whose name begins so) for a target, None if it never ended."""
        return next((r for r in self.runs if r.skill.startswith(skill) and r.target == target), None)


def kept_steps(position: FloatArray, up: FloatArray) -> IntArray:
    """Return the steps a track keeps: first, last, and each at which the object has moved since the step kept before.

    `position` has shape (n, 3), `up` shape (n,).
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


def _not_rising(steps: list[int], length: int) -> bool:
    return any(b <= a for a, b in pairwise(steps)) or steps[-1:] > [length - 1]
