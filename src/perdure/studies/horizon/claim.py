"""A testable claim: the conditions it compares, the measure, and the criterion for support.

    Claim(
        "constant-beats-discounted",
        "section 3.5",
        "With the best constant time-to-go the method matches or outperforms discounted PPO on every task.",
        tasks=("HalfCheetah-v3", "Hopper-v3@cleanrl"),
        left=Condition("geometric", "chosen"),
        right=Condition("ppo"),
        direction="not less",
        margin=0.05,
    )

The unit is the training run. The difference left minus right has a 95 % interval [low, high]: Student's t over paired
differences where both conditions are clocks of the same training runs, Welch's t otherwise. With m the margin:

| direction | supported | contradicted |
|---|---|---|
| greater | low > m | high <= m |
| less | high < -m | low >= -m |
| not less | low >= -m | high < -m |
| differs | low > m or high < -m | -m <= low and high <= m |
| same | -m <= low and high <= m | low > m or high < -m |

Anything else is undecided at this number of runs.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Literal, get_args

from perdure.studies.errors import StudyError

Direction = Literal["greater", "less", "not less", "differs", "same"]
DIRECTIONS: tuple[str, ...] = get_args(Direction)
Over = Literal["each", "mean"]
OVERS: tuple[str, ...] = get_args(Over)

MEASURES: dict[str, str] = {
    "return": "return of the whole test horizon",
    "return within": "return of the first 1,000 steps",
    "reward late": "reward per step in the last tenth of the test horizon; 0 after a fall",
    "gain": "return minus that of an idle robot in the same steps, as a share of a published policy's over the whole "
    "test horizon",
    "failed share": "share of episodes that fell, diverged, decayed, failed silently or never worked",
    "failed within": "share of episodes that failed within the first 1,000 steps, or never worked",
    "ended share": "share of episodes that ended before the test horizon (falls and divergence)",
    "hold share": "share of episodes that hold to the end",
    "hold": "hold score at the end; 0 for an ended episode",
    "level": "reward rate within the training horizon, 0: idle, 1: a published policy",
    "steps to failure": "steps before the failure; the test horizon where there was none",
    "training return": "mean return of the training episodes in the last tenth of training",
    "value error": "root mean square of (return to go - value), as a share of the spread of the returns to go",
    "value variance": "share of the variance of the returns to go that the value does not explain",
    "action dependence": "mean difference between the action with C and with 500 steps to go, over C = 0, 100, ..., "
    "1,000 without 500 and states of short rollouts, as a share of the action box",
    "fall rate": "falls per 1,000 steps in the mechanism rollouts",
}
"""Name of a measure to what it is in words. Each gives one number per training run."""

SHARES = ("gain", "failed share", "failed within", "ended share", "hold share", "value variance", "action dependence")
"""Measures whose margin is absolute; the margin of others is a share of the right side's mean."""

CLOCK_RULES: dict[str, str] = {
    "none": "no time-to-go input",
    "chosen": "the constant C that the other training runs choose on validation seeds",
    "chosen periodic": "the repeated countdown from C that the other training runs choose on validation seeds",
    "best": "the constant C with the highest mean on the reported seeds (optimistic)",
    "value": "the constant C that the critic ranks highest, without a sweep",
    "bandit": "the constant C that successive halving finds with short rollouts",
    "countdown": "countdown from the test horizon",
    "constant:C": "always C steps to go",
    "periodic:C": "countdown from C, repeated",
}
"""Name of a rule to what it means; C stands for a number."""


@dataclass(frozen=True)
class Condition:
    """A method deployed under a rule for its clock."""

    method: str
    """A key of `perdure.ppo.METHODS`."""
    clock: str = "none"
    """A key of CLOCK_RULES, such as "chosen" or "constant:500"."""

    def __post_init__(self) -> None:
        """Refuse an unknown rule."""
        if self.clock in CLOCK_RULES and ":" not in self.clock:
            return
        if re.fullmatch(r"(constant|periodic):\d+", self.clock) is None:
            raise _unknown("clock", self.clock, tuple(CLOCK_RULES))

    @property
    def label(self) -> str:
        """For tables, such as "geometric (chosen)"."""
        return self.method if self.clock == "none" else f"{self.method} ({self.clock})"


@dataclass(frozen=True)
class Claim:
    """A sentence that tables can support or contradict.

    Raises:
        StudyError: A field is out of range.
    """

    id: str
    """Short, lower-case words with dashes; unique."""
    source: str
    """Where the sentence stands, such as "section 3.5" or "figure 3-2"."""
    statement: str
    """Our paraphrase."""
    tasks: tuple[str, ...]
    """Tasks with their preset, as in the grid: "HalfCheetah-v3" (RL Zoo) or "Hopper-v3@cleanrl"."""
    left: Condition
    right: Condition | float
    """A condition, or a number that the left side's mean is compared with."""
    direction: Direction
    """What the sentence says of the left side beside the right one."""
    measure: str = "return"
    """A key of MEASURES."""
    margin: float = 0.0
    """Differences up to here do not matter: absolute for SHARES, else a share of the right side's mean (absolute where
    the right side is a number)."""
    over: Over = "each"
    """"each": the sentence is about every task named; "mean": about the mean over tasks of the difference, each divided
    by the right side's mean, which is taken as exact (left undivided for SHARES)."""
    note: str = ""
    """What a reader should know about the comparison."""

    def __post_init__(self) -> None:
        """Refuse what cannot be decided."""
        if re.fullmatch(r"[a-z0-9]+(-[a-z0-9]+)*", self.id) is None:
            raise StudyError(
                f"a claim's id is lower-case words with dashes, such as c-does-not-matter, not {self.id!r}"
            )
        if not self.tasks:
            raise StudyError(f"claim {self.id}: tasks is empty; name at least one")
        for name, value, known in (
            ("direction", self.direction, DIRECTIONS),
            ("measure", self.measure, tuple(MEASURES)),
            ("over", self.over, OVERS),
        ):
            if value not in known:
                raise _unknown(f"claim {self.id}: {name}", value, known)
        if not self.margin >= 0.0:
            raise StudyError(f"claim {self.id}: margin is {self.margin}; it is at least 0")


def _unknown(name: str, value: str, known: tuple[str, ...]) -> StudyError:
    near = get_close_matches(value, known, n=1)
    hint = f"; did you mean {near[0]!r}?" if near else ""
    return StudyError(f"{name} is {value!r}, known are {', '.join(known)}{hint}")
