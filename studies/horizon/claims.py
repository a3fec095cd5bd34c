"""Claims that tables can support or contradict: they stand in claims.toml, and are decided here.

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

import math
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, Self

import polars as pl

from perdure.stats import Difference, compare_paired, compare_unpaired, compare_with, holm, mean_difference

REGISTERED = Path(__file__).with_name("claims.toml")
LEVEL = 0.05
Direction = Literal["greater", "less", "not less", "differs", "same"]
Decision = Literal["supported", "contradicted", "undecided", "not evaluated"]

SCORE = "score vs published"
MEASURES: dict[str, str] = {
    "return": "return of the whole test horizon",
    "return within": "return of the first 1,000 steps",
    "reward late": "reward per step in the last tenth of the test horizon; 0 after a fall",
    SCORE: "score against a published policy: return minus that of an idle robot in the same steps, as a share of the "
    "published policy's over the whole test horizon",
    "failed share": "share of episodes that fell, diverged, decayed, failed silently or never worked",
    "failed within": "share of episodes that failed within the first 1,000 steps, or never worked",
    "ended share": "share of episodes that ended before the test horizon (falls and divergence)",
    "hold share": "share of episodes that hold to the end",
    "end score vs training": "score against its own training at the end; 0 for an ended episode",
    "training score vs published": "score against a published policy within the training horizon",
    "steps to failure": "steps before the failure; the test horizon where there was none",
    "training return": "mean return of the training episodes in the last tenth of training",
    "value error": "root mean square of (return to go - value), as a share of the spread of the returns to go",
    "value variance": "share of the variance of the returns to go that the value does not explain",
    "action dependence": "mean difference between the action with C and with 500 steps to go, over C = 0, 100, ..., "
    "1,000 without 500 and states of short rollouts, as a share of the action box",
    "fall rate": "falls per 1,000 steps in the mechanism rollouts",
}
"""Name of a measure to what it is in words. Each gives one number per training run."""

SHARES = (SCORE, "failed share", "failed within", "ended share", "hold share", "value variance", "action dependence")
"""Measures whose margin is absolute; the margin of others is a share of the right side's mean."""


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

    @property
    def label(self) -> str:
        """For tables, such as "geometric (chosen)"."""
        return self.method if self.clock == "none" else f"{self.method} ({self.clock})"


@dataclass(frozen=True)
class Claim:
    """A sentence that tables can support or contradict."""

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
    over: Literal["each", "mean"] = "each"
    """"each": the sentence is about every task named; "mean": about the mean over tasks of the difference, each divided
    by the right side's mean, which is taken as exact (left undivided for SHARES)."""
    note: str = ""
    """What a reader should know about the comparison."""
    registered: str = "first"
    """Claims that were registered together; Holm's correction counts them together."""


def read_claims(path: Path = REGISTERED) -> tuple[Claim, ...]:
    """Return the registered claims, in their order."""
    return tuple(_read_claim(**each) for each in tomllib.loads(path.read_text())["claim"])


def _read_claim(*, left: str, right: str | float, tasks: Sequence[str], **others: Any) -> Claim:
    other = Condition.parse(right) if isinstance(right, str) else right
    return Claim(left=Condition.parse(left), right=other, tasks=tuple(tasks), **others)


Values = Callable[[str, Condition, str], Mapping[int, float]]


@dataclass(frozen=True)
class TaskDecision:
    """One comparison."""

    task: str
    difference: Difference | None
    """None where a side is not evaluated."""
    margin: float
    """In the unit of the measure."""
    decision: Decision
    """By the 95 % interval."""
    p: float
    """Two-sided p value of the threshold nearest to the decision; nan where there is none."""
    permutation_p: float = math.nan
    """The same by a permutation test. It decides only where no side has any spread."""
    adjusted_p: float = math.nan
    """The same by Holm's method, over all comparisons of the claim table."""

    @property
    def after_holm(self) -> Decision:
        """The decision after Holm's correction for all comparisons."""
        return _after_holm(self.decision, self.adjusted_p)


@dataclass(frozen=True)
class ClaimDecision:
    """A claim with all its comparisons."""

    claim: Claim
    tasks: tuple[TaskDecision, ...]
    decision: Decision
    after_holm: Decision
    pooled: Difference | None = None
    """The mean over tasks, where the claim is about that."""
    pooled_p: float = math.nan
    adjusted_pooled_p: float = math.nan
    """Of the mean over tasks, as those of `TaskDecision`."""


def decide_claims(claims: Sequence[Claim], values: Values) -> list[ClaimDecision]:
    """Decide every claim; Holm's method counts the comparisons of those that were registered together.

    Args:
        claims: In the order of registration.
        values: From (setting, condition, measure) to the measure of each training run; {} where it is not there.
    """
    decided = [decide(claim, values) for claim in claims]
    for family in dict.fromkeys(claim.registered for claim in claims):
        members = [place for place, claim in enumerate(claims) if claim.registered == family]
        adjusted = iter(holm([p for place in members for p in p_values(decided[place])]))
        for place in members:
            decided[place] = _adjust(decided[place], [next(adjusted) for _ in p_values(decided[place])])
    return decided


def p_values(each: ClaimDecision) -> list[float]:
    """Return what a claim is decided by: one mean over tasks, or one comparison for each task."""
    return [each.pooled_p] if each.claim.over == "mean" else [task.p for task in each.tasks]


def _adjust(each: ClaimDecision, adjusted: Sequence[float]) -> ClaimDecision:
    if each.claim.over == "mean":
        after = _after_holm(each.decision, adjusted[0])
        return replace(each, after_holm=after, adjusted_pooled_p=adjusted[0])
    tasks = tuple(replace(task, adjusted_p=p) for task, p in zip(each.tasks, adjusted, strict=True))
    return replace(each, tasks=tasks, after_holm=combine([task.after_holm for task in tasks]))


def _after_holm(decision: Decision, adjusted_p: float) -> Decision:
    decided = decision in ("supported", "contradicted")
    return "undecided" if decided and not adjusted_p <= LEVEL else decision


def decide(claim: Claim, values: Values) -> ClaimDecision:
    """Decide one claim by 95 % intervals."""
    tasks = tuple(_decide_task(claim, task, values) for task in claim.tasks)
    if claim.over == "mean":
        pooled = mean_over_tasks(claim, [task.difference for task in tasks])
        if pooled is None:
            return ClaimDecision(claim, tasks, "not evaluated", "not evaluated")
        p = pooled.p(threshold(claim, pooled, claim.margin))
        decision = by_interval(claim, pooled, claim.margin) if math.isfinite(p) else "undecided"
        return ClaimDecision(claim, tasks, decision, decision, pooled, p)
    decision = combine([task.decision for task in tasks])
    return ClaimDecision(claim, tasks, decision, decision)


def combine(decisions: Sequence[Decision]) -> Decision:
    """Return the verdict on a sentence about each task."""
    if "contradicted" in decisions:
        return "contradicted"
    if all(each == "supported" for each in decisions):
        return "supported"
    return "not evaluated" if all(each == "not evaluated" for each in decisions) else "undecided"


def by_interval(claim: Claim, difference: Difference, margin: float) -> Decision:
    """Return the decision of the table in `claim`, from the 95 % interval."""
    low, high = difference.lower, difference.upper
    if not (math.isfinite(low) and math.isfinite(high)):
        return "undecided"
    beyond, within = low > margin or high < -margin, -margin <= low and high <= margin
    supported, contradicted = {
        "greater": (low > margin, high <= margin),
        "less": (high < -margin, low >= -margin),
        "not less": (low >= -margin, high < -margin),
        "differs": (beyond, within),
        "same": (within, beyond),
    }[claim.direction]
    return "supported" if supported else "contradicted" if contradicted else "undecided"


def threshold(claim: Claim, difference: Difference, margin: float) -> float:
    """Return the difference that the decision turns on."""
    fixed = {"greater": margin, "less": -margin, "not less": -margin}
    return fixed.get(claim.direction, math.copysign(margin, difference.estimate))


def _decide_task(claim: Claim, task: str, values: Values) -> TaskDecision:
    difference = _compare(claim, task, values)
    if difference is None:
        return TaskDecision(task, None, math.nan, "not evaluated", math.nan)
    margin = _margin(claim, difference.right)
    edge = threshold(claim, difference, margin)
    p = difference.p(edge)
    decision = by_interval(claim, difference, margin)
    if difference.error == 0.0 and not p <= LEVEL:  # runs that are all alike have no interval: their number decides
        decision = "undecided"
    return TaskDecision(task, difference, margin, decision, p, difference.permutation_p(edge))


def _compare(claim: Claim, task: str, values: Values) -> Difference | None:
    left = values(task, claim.left, claim.measure)
    if not left:
        return None
    if not isinstance(claim.right, Condition):
        return compare_with(list(left.values()), claim.right)
    right = values(task, claim.right, claim.measure)
    if not right:
        return None
    if claim.left.method == claim.right.method:
        return compare_paired(left, right)
    return compare_unpaired(list(left.values()), list(right.values()))


def _margin(claim: Claim, right: float) -> float:
    absolute = claim.measure in SHARES or not isinstance(claim.right, Condition)
    return claim.margin if absolute else claim.margin * abs(right)


def mean_over_tasks(claim: Claim, differences: Sequence[Difference | None]) -> Difference | None:
    """Return the mean over tasks of (left - right) / |mean of right|; the divisor of shares is 1.

    None where a task is not evaluated, has too few runs, or a right side's mean of 0.
    """
    known = [each for each in differences if each is not None and math.isfinite(each.error)]
    scales = [1.0 if claim.measure in SHARES else abs(each.right) for each in known]
    return None if len(known) < len(differences) or not all(scales) else mean_difference(known, scales)


def claims_frame(decided: Sequence[ClaimDecision]) -> pl.DataFrame:
    """Return one row for each comparison and one for each mean over tasks, for tables/claims.csv."""
    rows = [_row(each.claim, task) for each in decided for task in (*each.tasks, *_mean_row(each))]
    return pl.DataFrame(rows, infer_schema_length=None)


def _mean_row(each: ClaimDecision) -> list[TaskDecision]:
    if each.pooled is None:
        return []
    margin, p, adjusted = each.claim.margin, each.pooled_p, each.adjusted_pooled_p
    return [TaskDecision("mean of the tasks", each.pooled, margin, each.decision, p, adjusted_p=adjusted)]


def _row(claim: Claim, task: TaskDecision) -> dict[str, object]:
    found = task.difference
    tested = claim.over == "each" or not math.isnan(task.adjusted_p)
    return {
        "claim": claim.id,
        "task": task.task,
        "left": claim.left.label,
        "right": claim.right.label if isinstance(claim.right, Condition) else f"{claim.right:g}",
        "measure": claim.measure,
        "direction": claim.direction,
        "left mean": found.left if found else None,
        "right mean": found.right if found else None,
        "difference": found.estimate if found else None,
        "lower": found.lower if found else None,
        "upper": found.upper if found else None,
        "runs": found.count if found else "0",
        "method": found.method if found else "",
        "probability of improvement": found.improvement if found else None,
        "margin": task.margin if found else None,
        "p": task.p if found else None,
        "p by permutation": task.permutation_p if found else None,
        "p by Holm": task.adjusted_p if found else None,
        "decision": task.decision,
        "after Holm": task.after_holm if tested or found is None else None,
    }
