"""Disturbances as command lines declare them, and the base class of their kinds."""

from __future__ import annotations

import math
import re
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from perdure.errors import PerdureError, lookup
from perdure.registry import Registered

FloatArray: TypeAlias = npt.NDArray[np.float64]
IntArray: TypeAlias = npt.NDArray[np.int64]
BoolArray: TypeAlias = npt.NDArray[np.bool_]
CALM = "none"
"""Name of no disturbance at all, also in tables."""
STANDARDS: dict[str, tuple[str, ...]] = {
    "standard-1": (
        "action_noise:0.02",
        "observation_noise:0.01",
        "push:0.1",
        "mass:1.05",
        "friction:0.95",
        "strength:0.95",
    )
}
"""Disturbances that act together under one name, which always means the same ones: 1 or 2 % noise, 5 % error in the
model, small pushes. The levels are mild beside what the Real-World RL suite (Dulac-Arnold et al. 2020), RRLS and
Robust-Gymnasium vary. They were chosen, on start states that no study uses, so that some policies pass: at twice these
levels no run of ten Hoppers with a time-to-go did. No delay: a control step is 8 ms on Hopper and 50 ms on HalfCheetah,
and one step of delay is too much for nearly every policy trained without."""
STANDARD = "standard-1"
"""What an evaluation applies if nothing else is asked for."""


# What is declared


@dataclass(frozen=True)
class Disturbance:
    """One way to disturb a robot, at one level, for a whole episode or as a fault with an onset and a duration.

    Raises:
        PerdureError: If there is no such kind, the level means nothing, or the kind takes no onset.
    """

    name: str
    """Of a subclass of `Effect`."""
    level: float
    onset: int = 0
    """Steps before the first disturbed one."""
    duration: int | None = None
    """Disturbed steps; None: until the episode ends."""

    def __post_init__(self) -> None:
        self.kind.check(self.level)
        if self.onset < 0 or (self.duration is not None and self.duration < 1):
            raise PerdureError(
                f"{self.name}: the onset must be at least 0 steps and the duration at least 1, got {self.onset} and "
                f"{self.duration}"
            )
        if self.is_timed and self.kind.no_time:
            raise PerdureError(f"{self.label}: {self.name} acts for whole episodes only: {self.kind.no_time}")

    @property
    def kind(self) -> type[Effect]:
        """The class of that name."""
        return lookup(Effect.kinds(), self.name, "disturbance")

    @property
    def first_step(self) -> int:
        """Steps before the first one in which it acts."""
        return self.kind.first_step(self.onset)

    @property
    def is_timed(self) -> bool:
        """Whether there are undisturbed steps before its onset or after its duration."""
        return self.onset > 0 or self.duration is not None

    @property
    def label(self) -> str:
        """The text that `parse_disturbance` reads, such as ``push:0.5`` or ``strength:0.5@2000+500``."""
        level = f"{self.name}:{level_text(self.level)}"
        if not self.is_timed:
            return level
        if self.duration is None:
            return f"{level}@{self.onset}"
        return f"{level}@{self.onset}+{self.duration}"

    def acts(self, elapsed: IntArray) -> BoolArray:
        """Return whether it acts in a step, shape (n,).

        Args:
            elapsed: Steps before this one, shape (n,).
        """
        begun = elapsed >= self.onset
        if self.duration is None:
            return begun
        return begun & (elapsed < self.onset + self.duration)


def level_text(level: float) -> str:
    """Return a level as text that reads back exactly, in six digits where those do: "0.5", "2", "0.1234567"."""
    short = f"{level:g}"
    if float(short) == level:
        return short
    return repr(float(level)).removesuffix(".0")


def split_text(text: str) -> tuple[str, str, str]:
    """Return name, level and time of a text: "push:0.5@2000+500" -> ("push", "0.5", "2000+500"); "" for what lacks."""
    name, _, rest = text.strip().partition(":")
    level, _, time = rest.partition("@")
    return name, level, time


def parse_disturbance(text: str) -> Disturbance:
    """Return the disturbance of a text: ``push:0.5``, or ``push:0.5@2000+500`` for 500 steps from step 2,000 on.

    Raises:
        PerdureError: If it names none, or level or time are out of range.
    """
    name, level, time = split_text(text)
    try:
        number = float(level)
    except ValueError:
        raise PerdureError(
            f"a disturbance is written name:level, for example push:0.5, or one of {', '.join(STANDARDS)}, or {CALM} "
            f"alone; got {text!r}"
        ) from None
    if "@" not in text:
        return Disturbance(name, number)
    found = re.fullmatch(r"([0-9]{1,9})(?:\+([0-9]{1,9}))?", time)
    if found is None:
        raise PerdureError(
            f"the time of a disturbance is written @ONSET or @ONSET+DURATION in steps, for example push:0.5@2000+500; "
            f"got {text!r}"
        )
    duration = None
    if found[2] is not None:
        duration = int(found[2])
    return Disturbance(name, number, int(found[1]), duration)


def parse_disturbances(texts: Sequence[str]) -> tuple[Disturbance, ...]:
    """Return disturbances that act together, in one order; none for "none", and all of a name in `STANDARDS`.

    Raises:
        PerdureError: If a text names none, or a kind is named twice.
    """
    if tuple(texts) == (CALM,):
        return ()
    if CALM in texts:
        raise PerdureError(f"{CALM} cannot be combined with disturbances: {' '.join(texts)}")
    found: list[Disturbance] = []
    for text in texts:
        found += map(parse_disturbance, STANDARDS.get(text, (text,)))
    if len({each.name for each in found}) < len(found):
        raise PerdureError(f"one kind of disturbance is named twice: {', '.join(each.label for each in found)}")
    return tuple(sorted(found, key=lambda each: each.name))


def labels(disturbances: Sequence[Disturbance]) -> str:
    """Return how tables name disturbances that act together: "action_noise:0.1 push:0.5"."""
    return " ".join(each.label for each in disturbances) or CALM


def applied_disturbances(label: str, not_applied: str) -> tuple[Disturbance, ...]:
    """Return the disturbances that episodes of a table met.

    Args:
        label: Their column `disturbance`: as of `labels`, or a name in `STANDARDS`.
        not_applied: Their column `not_applied`: names of the kinds that the world could not do, after commas.
    """
    left_out = not_applied.split(", ")
    return tuple(each for each in parse_disturbances(label.split()) if each.name not in left_out)


def check_onsets(disturbances: Sequence[Disturbance], steps: float) -> None:
    """Raise PerdureError if a disturbance would begin after the last of so many steps of an episode."""
    for each in disturbances:
        if each.onset >= steps:
            raise PerdureError(f"{each.label} would never act: its episodes have {steps:,g} steps")


def neutral_level(name: str) -> float:
    """Return the level of a kind that changes nothing; 0 for a kind that is not installed here."""
    kind = Effect.kinds().get(name)
    if kind is None:
        return 0.0
    return kind.neutral


def examples() -> str:
    """Return a list of all kinds for help texts: "action_noise:0.1 (of half the action range), ..."."""
    return ", ".join(f"{name}:{kind.example:g} ({kind.unit})" for name, kind in Effect.kinds().items())


# The vocabulary


class Simulator(NamedTuple):
    """MuJoCo's simulator of one lane."""

    env: Any
    """Gymnasium's environment, unwrapped."""
    model: Any
    data: Any


class Robots:
    """What an effect may use of the robots that it disturbs, one in each of n lanes."""

    def __init__(
        self,
        name: str,
        seeds: Sequence[int],
        box: tuple[FloatArray, FloatArray] | None,
        observation_std: FloatArray | None,
    ) -> None:
        self.name = name
        """Of the task, for messages."""
        self.seeds = list(seeds)
        self.episodes = np.zeros(len(self.seeds), np.int64)
        """Episodes begun in each lane: each one has its own draws."""
        if box is None:
            box = (np.zeros(0), np.zeros(0))
        self.low, self.high = box
        """Lowest and highest action, each of shape (action_size,); of size 0 where actions are not a box."""
        self.neutral_action = np.clip(np.zeros(len(self.low)), self.low, self.high)
        """The action nearest to zero, shape (action_size,)."""
        self.knows_spread = observation_std is not None
        if observation_std is None:
            observation_std = np.zeros((len(seeds), 0))
        self.observation_std = np.array(observation_std, float)
        """Spread of each observation component in training, shape (n, observation_size)."""
        self.simulators: list[Simulator] = []
        """One for each lane if an effect needs them, else none."""

    def __len__(self) -> int:
        return len(self.seeds)

    def clip(self, actions: FloatArray) -> FloatArray:
        """Return actions inside the box, a new array of shape (n, action_size)."""
        return np.minimum(np.maximum(actions, self.low), self.high)

    def generator(self, kind: str, lane: int, step: int) -> np.random.Generator:
        """Return the generator of an effect's draws at a step, or for a block of steps, in this episode of a lane."""
        key = [self.seeds[lane], zlib.crc32(kind.encode()), int(self.episodes[lane]), step]
        return np.random.Generator(np.random.Philox(np.random.SeedSequence(key)))


class Effect(Registered):
    """One kind of disturbance: its words and bounds, and what it does to the robots of n lanes.

    A subclass overrides the methods in which it acts; the others do nothing. What it remembers of each lane, such as a
    queue of actions, are attributes that its `prepare` makes. Before the onset and after the duration of a disturbance
    its results are not used, and models are what they were. Actions, observations and lanes are rows of arrays.
    """

    words: ClassVar[str]
    """What happens at a `level`."""
    unit: ClassVar[str]
    """Of the level, for lists."""
    example: ClassVar[float]
    """A level that is worth trying."""
    source: ClassVar[str] = ""
    """Publication that disturbs robots in this way."""
    neutral: ClassVar[float] = 0.0
    """The level that changes nothing: 1 for factors."""
    least: ClassVar[float] = 0.0
    """Lowest level."""
    below: ClassVar[float] = math.inf
    """Levels are less than this."""
    no_time: ClassVar[str] = ""
    """Why it takes no onset and duration; "": it takes them."""
    place: ClassVar[int] = 50
    """Effects act in the order of their places, those of one place in the order of their names. An action meets noise,
    then delay, then lag."""
    needs_action_box: ClassVar[bool] = False
    """Whether it needs actions in a finite box."""

    def __init__(self, disturbance: Disturbance, robots: Robots) -> None:
        self.disturbance = disturbance
        self.level = disturbance.level
        self.robots = robots
        self.prepare()

    @classmethod
    def check(cls, level: float) -> None:
        """Raise PerdureError if a level is out of range."""
        if not cls.least <= level < math.inf:
            raise PerdureError(f"the level of {cls.name} must be {cls.least:g} or more, got {level}")
        if level >= cls.below:
            raise PerdureError(f"the level of {cls.name} must be less than {cls.below:g}, got {level}")

    @classmethod
    def first_step(cls, onset: int) -> int:
        """Return the steps before the first one in which it acts."""
        return onset

    @classmethod
    def overrides(cls, method: str) -> bool:
        """Return whether the class acts in a method."""
        return getattr(cls, method) is not getattr(Effect, method)

    @classmethod
    def needs_simulator(cls) -> bool:
        """Return whether it needs MuJoCo's own model and data."""
        return cls.overrides("change_model") or cls.overrides("on_state")

    def prepare(self) -> None:
        """Make what the effect remembers of each lane; PerdureError if it cannot act on these robots."""

    def on_begin(self, lanes: IntArray) -> None:
        """Forget the last episode of these lanes, shape (n,); it is called before they are reset."""

    def change_model(self, model: Any) -> None:
        """Change a model of MuJoCo in place; where a disturbance has ended, it is put back."""

    def on_action(self, actions: FloatArray, lanes: IntArray, elapsed: IntArray) -> FloatArray:
        """Return the actions that act in a step, a new array, shape (n, action_size); they are clipped later.

        Args:
            actions: Of the policy, after the effects before this one.
            lanes: Lane numbers, shape (n,).
            elapsed: Steps before this one, shape (n,).
        """
        return actions

    def on_state(self, lanes: IntArray, elapsed: IntArray) -> None:
        """Change the state of `self.robots.simulators` before a step; for lanes where the disturbance acts."""

    def on_observation(self, observations: FloatArray, lanes: IntArray, elapsed: IntArray) -> FloatArray:
        """Return what the policy observes, shape (n, observation_size); `observations` may be changed in place."""
        return observations
