"""Decide claims from tables: a comparison for each task, then one decision for the claim."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

from perdure.studies.comparison import Difference, compare_paired, compare_unpaired, compare_with, holm, mean_difference
from perdure.studies.horizon.claim import SHARES, Claim, Condition
from perdure.studies.horizon.results import Results

Decision = Literal["supported", "contradicted", "undecided", "not evaluated"]
LEVEL = 0.05


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
    adjusted_permutation_p: float = math.nan
    """Holm's method over the permutation tests of all comparisons."""
    planned: bool = True
    """Whether the study measures both sides."""

    @property
    def after_holm(self) -> Decision:
        """The decision after Holm's correction for all comparisons."""
        return _survivor(self.decision, self.adjusted_p)


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

    @property
    def by_decision(self) -> dict[Decision, list[str]]:
        """The tasks of each decision, after Holm; {} where the mean over tasks is decided and no task for itself."""
        found: dict[Decision, list[str]] = {}
        if self.claim.over == "mean":
            return found
        for task in self.tasks:
            found.setdefault(task.after_holm, []).append(task.task)
        return found


def decide_claims(claims: Sequence[Claim], results: Results) -> list[ClaimDecision]:
    """Decide every claim; Holm's method counts the comparisons of all of them."""
    decided = [decide(claim, results) for claim in claims]
    adjusted = iter(holm([p for each in decided for p in p_values(each)]))
    permuted = iter(holm([p for each in decided for p in _permutation_p_values(each)]))
    return [
        _count_all(each, [next(adjusted) for _ in p_values(each)], [next(permuted) for _ in p_values(each)])
        for each in decided
    ]


def p_values(each: ClaimDecision) -> list[float]:
    """Return what a claim is decided by: one mean over tasks, or one comparison for each task."""
    return [each.pooled_p] if each.claim.over == "mean" else [task.p for task in each.tasks]


def _permutation_p_values(each: ClaimDecision) -> list[float]:
    """Return the same by permutation tests, of which a mean over tasks has none."""
    return [math.nan] if each.claim.over == "mean" else [task.permutation_p for task in each.tasks]


def _count_all(each: ClaimDecision, adjusted: Sequence[float], permuted: Sequence[float]) -> ClaimDecision:
    if each.claim.over == "mean":
        after = _survivor(each.decision, adjusted[0])
        return replace(each, after_holm=after, adjusted_pooled_p=adjusted[0])
    tasks = tuple(
        replace(task, adjusted_p=p, adjusted_permutation_p=permutation_p)
        for task, p, permutation_p in zip(each.tasks, adjusted, permuted, strict=True)
    )
    return replace(each, tasks=tasks, after_holm=combine([task.after_holm for task in tasks]))


def _survivor(decision: Decision, adjusted_p: float) -> Decision:
    decided = decision in ("supported", "contradicted")
    return "undecided" if decided and not adjusted_p <= LEVEL else decision


def decide(claim: Claim, results: Results) -> ClaimDecision:
    """Decide one claim by 95 % intervals."""
    tasks = tuple(_decide_task(claim, task, results) for task in claim.tasks)
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


def _decide_task(claim: Claim, task: str, results: Results) -> TaskDecision:
    difference = _compare(claim, task, results)
    if difference is None:
        methods = [each.method for each in (claim.left, claim.right) if isinstance(each, Condition)]
        planned = all(results.is_planned(task, method, claim.measure) for method in methods)
        return TaskDecision(task, None, math.nan, "not evaluated", math.nan, planned=planned)
    margin = _margin(claim, difference.right)
    edge = threshold(claim, difference, margin)
    p = difference.p(edge)
    decision = by_interval(claim, difference, margin)
    if difference.error == 0.0 and not p <= LEVEL:  # runs that are all alike have no interval: their number decides
        decision = "undecided"
    return TaskDecision(task, difference, margin, decision, p, difference.permutation_p(edge))


def _compare(claim: Claim, task: str, results: Results) -> Difference | None:
    left = results.values(task, claim.left, claim.measure)
    if not left:
        return None
    if not isinstance(claim.right, Condition):
        return compare_with(list(left.values()), claim.right)
    right = results.values(task, claim.right, claim.measure)
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
