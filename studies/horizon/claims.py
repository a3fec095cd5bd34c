"""What the thesis says, sentence by sentence (claims.toml), beside what the tables say.

The unit is the training run. The effect, left minus right, is the mean over tasks. Its 95 % interval [low, high] is
Student's t over paired differences where both sides are clocks of the same training runs, Welch's t otherwise.

| direction | supported | contradicted |
|---|---|---|
| greater | low > 0 | high <= 0 |
| less | high < 0 | low >= 0 |
| not less | low >= -0.1 | high < -0.1 |

Anything else is undecided at this number of runs.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Self

import numpy as np

from perdure.stats import Difference, compare_paired, compare_unpaired, compare_with, mean_difference
from studies.horizon.grid import MAIN_SETTINGS

CLAIMS = Path(__file__).with_name("claims.toml")
MARGIN = 0.1
"""Of "not less": the margin of the fifth registered claim."""
SCORE = "score vs published"


@dataclass(frozen=True)
class Condition:
    """A method deployed under a rule for its clock."""

    method: str
    """As the grid names it."""
    clock: str = "none"
    """A rule of claims.toml, such as "chosen" or "constant:500"."""

    @classmethod
    def parse(cls, text: str) -> Self:
        """Return the condition in a text such as "ppo" or "geometric constant:500"."""
        method, _, clock = text.partition(" ")
        return cls(method, clock or "none")


@dataclass(frozen=True)
class Claim:
    """A sentence that tables can support or contradict; its parts as claims.toml names them."""

    sentence: str
    source: str
    left: str
    right: str | float
    direction: Literal["greater", "less", "not less"]
    measure: str = SCORE
    tasks: tuple[str, ...] = MAIN_SETTINGS


def read_claims() -> list[Claim]:
    """Return the claims, in their order."""
    return [Claim(**each) for each in tomllib.loads(CLAIMS.read_text())["claim"]]


Values = Callable[[str, Condition, str], Mapping[int, float]]
"""From (setting, condition, measure) to the measure of each training run; {} where it is not there."""


def effect(claim: Claim, values: Values) -> Difference | None:
    """Return left minus right, the mean over tasks; None where a task is not evaluated."""
    found = []
    for task in claim.tasks:
        sides = [
            values(task, Condition.parse(side), claim.measure)
            for side in (claim.left, claim.right)
            if isinstance(side, str)
        ]
        if any(len(side) < 2 for side in sides):
            return None
        if not isinstance(claim.right, str):
            found.append(compare_with(list(sides[0].values()), claim.right))
        elif Condition.parse(claim.left).method == Condition.parse(claim.right).method:
            found.append(compare_paired(*sides))
        else:
            found.append(compare_unpaired(*(list(side.values()) for side in sides)))
    return mean_difference(found)


def decide(claim: Claim, low: float, high: float) -> str:
    """Return the decision of the table above, from the 95 % interval."""
    supported, contradicted = {
        "greater": (low > 0.0, high <= 0.0),
        "less": (high < 0.0, low >= 0.0),
        "not less": (low >= -MARGIN, high < -MARGIN),
    }[claim.direction]
    return "supported" if supported else "contradicted" if contradicted else "undecided"


def p_value(claim: Claim, found: Difference) -> float:
    """Return the two-sided p value of the bound that decides a claim, by Student's t; nan with too few runs."""
    from scipy.special import stdtr

    if not found.error > 0.0:
        return float("nan")
    bound = -MARGIN if claim.direction == "not less" else 0.0
    return float(2.0 * stdtr(found.freedom, -abs(found.estimate - bound) / found.error))


def holm(values: Sequence[float]) -> list[float]:
    """Return p values corrected for their number [Holm, 1979, Scandinavian Journal of Statistics 6]."""
    plain = np.asarray(values, np.float64)
    order = np.argsort(plain)  # nan comes last
    steps = (len(plain) - np.arange(len(plain))) * plain[order]
    corrected = np.empty_like(plain)
    corrected[order] = np.minimum(np.maximum.accumulate(steps), 1.0)
    return [float(each) for each in corrected]
