"""Write the claim table: each claim with estimate, interval, decision, and the condition that would change it."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence

import numpy as np
import polars as pl

from perdure.report import wording
from perdure.studies.comparison import CONFIDENCE, FEWEST, Difference
from perdure.studies.horizon import words
from perdure.studies.horizon.claim import CLOCK_RULES, MEASURES, SHARES, Claim, Condition
from perdure.studies.horizon.decide import LEVEL, ClaimDecision, Decision, TaskDecision, p_values, threshold
from perdure.studies.horizon.tables import MEASURED

POWER = 0.8
"""Of the number of training runs that would decide a claim."""
MOST_RUNS = 50
"""Larger numbers of training runs are not estimated."""
COLUMNS = (
    *("task", "left", "right", "difference (95 % interval)", "runs", "P(left > right)", "p", "p (permutation)"),
    *("p (Holm)", "decision"),
)
HEAD = """# Claims

Each claim compares two conditions, left and right. The 95 % interval of left minus right decides it. Training runs are
the units: Student's t over paired differences where both sides are clocks of the same training runs, or over one side
where the other is a number; Welch's t otherwise. A right side's mean by which something is divided is taken as exact.
With three to ten runs that either hold or fail, Student's t is approximate, so the p value of a permutation test stands
beside it (signs flipped, or runs exchanged between the sides). Where no side has any spread there is no interval, and
that test decides at {level:g}. A chosen C is chosen by the other runs, so runs under it are not quite independent.

{registered}
"After Holm" is the decision that remains when all comparisons that were registered together are counted, evaluated or
not (Holm's method at {level:g}). P(left > right): share of pairs of training runs in which the left side is greater, or
of training runs where both sides are the same runs or one is a number; ties count half. An interval of a share may
reach beyond 0 and 1. Runs whose verdict is "cannot tell" have no share of failures. Tasks without a preset in brackets
use the settings of RL Baselines3 Zoo. Margins are our choice.

"""


def claims_text(families: Sequence[Sequence[ClaimDecision]]) -> str:
    """Return the page, in Markdown: an overview, then every claim with its comparisons.

    Args:
        families: Claims that were registered together, in the order of registration.
    """
    decided = [each for family in families for each in family]
    counts = Counter(each.decision for each in decided)
    summary = ", ".join(f"{number} {name}" for name, number in counts.most_common())
    parts = [HEAD.format(registered=registered(families), level=LEVEL)]
    if not decided:
        return parts[0] + "No claim is registered.\n"
    parts.append(f"{wording.count(len(decided), 'claim')}: {summary}.\n\n")
    parts.append("| claim | source | decision | after Holm | tasks, after Holm |\n|---|---|---|---|---|\n")
    parts += [
        f"| [{each.claim.id}](#{each.claim.id}) | {each.claim.source} | {each.decision} | {each.after_holm} "
        f"| {by_task(each)} |\n"
        for each in decided
    ]
    parts += [_claim_text(each) for each in decided]
    return "".join(parts)


def registered(families: Sequence[Sequence[ClaimDecision]]) -> str:
    """Return how many comparisons were registered together, and how many of them are evaluated, as sentences."""
    sizes = [(len(tests), sum(map(math.isfinite, tests))) for family in families if (tests := _tests(family))]
    if not sizes:
        return ""
    (number, evaluated), *later = sizes
    text = f"Of {number} comparisons that were registered first, {evaluated or 'none'} are evaluated."
    for number, evaluated in later:
        text += f" Of {number} registered later and corrected by themselves, {evaluated or 'none'} are."
    return text


def _tests(family: Sequence[ClaimDecision]) -> list[float]:
    return [p for each in family for p in p_values(each)]


def by_task(each: ClaimDecision) -> str:
    """Return the tasks of each decision after Holm: "supported on Hopper-v3 (CleanRL); undecided on HalfCheetah-v3"."""
    if each.after_holm == "not evaluated":
        return ""
    return "; ".join(f"{decision} {where}" for decision, where in places(each).items())


def places(each: ClaimDecision) -> dict[Decision, str]:
    """Return where each decision was taken after Holm: "on Hopper-v3, Ant-v3", or "on average over the tasks"."""
    if each.claim.over == "mean":
        return {each.after_holm: "on average over the tasks"}
    return {decision: f"on {', '.join(map(words.setting, tasks))}" for decision, tasks in each.by_decision.items()}


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
        "right": _right(claim),
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


def _claim_text(each: ClaimDecision) -> str:
    claim = each.claim
    head = (
        f"\n## {claim.id}\n\n> {claim.statement}\n\n"
        f"{claim.source[0].upper()}{claim.source[1:]}. Left: {_words(claim.left, claim)}. "
        f"Right: {_right_words(claim)}. Measure: {MEASURES[claim.measure]}. The sentence says: left {_says(claim)}. "
        f"**{each.decision[0].upper()}{each.decision[1:]}**"
    )
    head += "" if each.after_holm == each.decision else f" (counting all comparisons: {each.after_holm})"
    rows = "".join(_task_line(claim, task) for task in each.tasks)
    table = f".\n\n| {' | '.join(COLUMNS)} |\n{'|---' * len(COLUMNS)}|\n{rows}"
    pooled = "" if each.pooled is None else _pooled_text(each, each.pooled)
    note = f"\n{claim.note}\n" if claim.note else ""
    return f"{head}{table}{pooled}{note}\nWhat would change it: {_would_change(each)}\n"


def _pooled_text(each: ClaimDecision, pooled: Difference) -> str:
    unit = "" if each.claim.measure in SHARES else ", each as a share of the right side's mean"
    p = f"p {_p(each.pooled_p)}, by Holm {_p(each.adjusted_pooled_p)}"
    return f"\nMean of the differences over tasks{unit}: {_interval(pooled)}, {p}.\n"


def _task_line(claim: Claim, task: TaskDecision) -> str:
    found = task.difference
    if found is None:
        return f"| {task.task} | | | | 0 | | | | | not {'evaluated' if task.planned else 'planned'} |\n"
    cells = [
        task.task,
        wording.quantity(found.left),
        wording.quantity(found.right),
        _interval(found),
        f"{found.count} ({found.method if found.error != 0.0 else 'no spread'})",
        wording.share(found.improvement),
        _p(task.p),
        _p(task.permutation_p),
        _p(task.adjusted_p),
        task.decision if claim.over == "each" else "\u2013",
    ]
    return f"| {' | '.join(cells)} |\n"


def _interval(found: Difference) -> str:
    if not math.isfinite(found.half):
        return f"{wording.quantity(found.estimate)} (no interval)"
    if found.error == 0.0:
        return f"{wording.quantity(found.estimate)} (no spread)"
    low, high = wording.quantity(found.lower), wording.quantity(found.upper)
    return f"{wording.quantity(found.estimate)} ({low} to {high})"


def _p(value: float) -> str:
    return "\u2013" if math.isnan(value) else "< 0.001" if value < 0.001 else f"{value:.3f}"


def _words(condition: Condition, claim: Claim) -> str:
    if condition.clock == "none" or claim.measure not in MEASURED:
        return f"`{condition.method}`"
    return f"`{condition.method}` under {_clock_words(condition.clock)}"


def _clock_words(rule: str) -> str:
    if ":" in rule:
        kind, _, steps = rule.partition(":")
        return wording.clock(kind, steps)
    return CLOCK_RULES[rule]


def _right(claim: Claim) -> str:
    return claim.right.label if isinstance(claim.right, Condition) else f"{claim.right:g}"


def _right_words(claim: Claim) -> str:
    return _words(claim.right, claim) if isinstance(claim.right, Condition) else f"the number {claim.right:g}"


def _says(claim: Claim) -> str:
    absolute = claim.measure in SHARES or not isinstance(claim.right, Condition)
    size = f"{claim.margin:g}" if absolute else f"{100.0 * claim.margin:g} % of the right side's mean"
    more = f" by more than {size}" if claim.margin else ""
    words = {
        "greater": f"is greater{more}",
        "less": f"is less{more}",
        "not less": f"is not less than right{more}",
        "differs": f"differs{more}",
        "same": f"is the same within {size}",
    }[claim.direction]
    return words + {"each": " on every task", "mean": " on average over the tasks"}[claim.over]


def _would_change(each: ClaimDecision) -> str:
    claim = each.claim
    if each.pooled is None:
        changes = [_task_change(claim, task) for task in each.tasks]
    else:
        changes = [_change("the mean", claim, each.pooled, claim.margin, each.decision)]
    return " ".join(changes)


def _task_change(claim: Claim, task: TaskDecision) -> str:
    if task.difference is None:
        return f"{task.task}: {'its evaluation' if task.planned else 'nothing, one side is not measured'}."
    return _change(task.task, claim, task.difference, task.margin, task.decision)


def _change(name: str, claim: Claim, found: Difference, margin: float, decision: Decision) -> str:
    """Return the number of runs that would decide, or the distance of the interval from the threshold, as text."""
    if not math.isfinite(found.half):
        return f"{name}: at least two training runs on each side."
    edge = threshold(claim, found, margin)
    away = abs(found.estimate - edge)
    if decision != "undecided":
        slack, where = wording.quantity(away - found.half), wording.quantity(edge + 0.0)
        return f"{name}: undecided again if the difference moved by {slack} towards {where}."
    if away == 0.0:
        return f"{name}: nothing, the difference is exactly at the threshold."
    if found.error == 0.0:
        runs = max(found.n_left, found.n_right)
        return f"{name}: more training runs that agree; {runs} cannot decide at {LEVEL:g}."
    needed = runs_needed(found, away)
    number = f"more than {MOST_RUNS}" if needed is None else f"about {needed}"
    sides = " on each side" if found.n_right not in (0, found.n_left) else ""
    return f"{name}: {number} training runs{sides}, if difference and spread stay as they are (80 % power)."


def runs_needed(found: Difference, away: float) -> int | None:
    """Return the least number of runs, at most `MOST_RUNS`, with a power of 80 %; None where they are not enough.

    The difference is detected if it is at least t(0.975) + t(0.8) standard errors from the threshold. Both sides get
    equally many runs.

    Args:
        found: With a spread.
        away: Distance of the difference from the threshold, not 0.
    """
    from scipy.special import stdtrit

    sides = [np.var(each, ddof=1) for each in found.samples]
    now = min(found.n_left, found.n_right or found.n_left)
    squared = float(sum(sides)) if sides else now * found.error**2
    for runs in range(FEWEST, MOST_RUNS + 1):
        freedom = (runs - 1.0) * (len(sides) or found.freedom / max(now - 1, 1))
        quantiles = float(stdtrit(freedom, 0.5 + CONFIDENCE / 2.0) + stdtrit(freedom, POWER))
        if away >= quantiles * math.sqrt(squared / runs):
            return runs
    return None
