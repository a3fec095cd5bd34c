"""Compare clocks of one policy by paired differences on common start states."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby

import numpy as np

from perdure.report import wording
from perdure.report.estimates import Estimate
from perdure.report.groups import FloatArray, Group
from perdure.report.statistics import DEFAULT, Bootstrap, mean_interval

CLOCK_HEADINGS = (
    "policy",
    "clock",
    "against",
    "difference of the return",
    "95 % interval",
    "better in",
    "intervals over",
)
_MOST_LISTED = 6
"""Most clocks that a sentence lists."""


def compare_clocks(
    estimates: Sequence[Estimate], rng: np.random.Generator, how: Bootstrap = DEFAULT
) -> list[tuple[str, ...]]:
    """Compare each clock with the first one of the same line, on the policies and start states that both have.

    Args:
        estimates: Groups of one task in the order of `make_groups`.
        rng: For bootstrap intervals.
        how: Method and confidence of the intervals.

    Returns:
        Cells under CLOCK_HEADINGS, one row for each clock but the first.
    """
    rows: list[tuple[str, ...]] = []
    for line, items in groupby(estimates, key=lambda item: item.group.line):
        first, *others = [item.group for item in items]
        for group in others:
            mine, its = _common(group, first)
            if not mine:
                continue
            difference = group.returns[mine, -1] - first.returns[its, -1]
            found = mean_interval(difference, group.runs[mine], rng, how)
            low, high = float(found.lower), float(found.upper)
            rows.append(
                (
                    line,
                    group.clock,
                    first.clock,
                    wording.quantity(float(found.estimate)),
                    "\u2013" if np.isnan(low) else f"{wording.quantity(low)} to {wording.quantity(high)}",
                    f"{int((difference > 0).sum())} of {wording.count(len(mine), 'episode')}",
                    f"{found.label} ({found.method}, {wording.count(found.count, 'unit')})",
                )
            )
    return rows


def best_clocks(estimates: Sequence[Estimate], rng: np.random.Generator, how: Bootstrap = DEFAULT) -> list[str]:
    """Return one sentence for each line with several clocks: the best one, and those as good as it.

    The best clock has the largest share of episodes that hold, and of those the highest mean return. Another one is as
    good unless it is worse in one of the two: unless the interval of its paired difference lies below 0. The intervals
    are not corrected for the number of clocks.

    Args:
        estimates: As in `compare_clocks`.
        rng: For bootstrap intervals.
        how: Method and confidence of the intervals.
    """
    sentences = []
    for line, items in groupby(estimates, key=lambda item: item.group.line):
        clocks = list(items)
        if len(clocks) < 2 or len({frozenset(item.group.keys) for item in clocks}) > 1:
            continue
        best = best_clock(clocks)
        if not float(best.verdict.share.estimate):
            sentences.append(f"No episode of {line} holds under any of {len(clocks)} clocks.")
            continue
        same = [item.group.clock_words for item in clocks if item is not best and _as_good(item, best, rng, how)]
        listed = ", ".join(same) if len(same) <= _MOST_LISTED else wording.count(len(same), "clock")
        sentences.append(
            f"Best clock of {line} on these start states: {best.group.clock_words}."
            + (f" Not distinguishable from it (share that holds, return; 95 % each): {listed}." if same else "")
            + " Confirm it on others (--first-eval-seed)."
        )
    return sentences


def best_clock(estimates: Sequence[Estimate]) -> Estimate:
    """Return the clock with the largest share of episodes that hold, and of those the highest mean return."""
    return max(estimates, key=lambda item: (float(item.verdict.share.estimate), item.final_return))


def _as_good(item: Estimate, best: Estimate, rng: np.random.Generator, how: Bootstrap) -> bool:
    mine, its = _common(item.group, best.group)
    for values, others in ((_holding(item.group), _holding(best.group)), (item.group.returns, best.group.returns)):
        found = mean_interval(values[mine, -1] - others[its, -1], item.group.runs[mine], rng, how)
        if float(found.upper) < 0.0:
            return False
    return True


def _holding(group: Group) -> FloatArray:
    """Return 1 for lanes that hold and 0 for others, shape (lanes, 1)."""
    return np.array([[float(verdict == "holds")] for verdict in group.verdicts])


def _common(one: Group, other: Group) -> tuple[list[int], list[int]]:
    """Return the lanes of two groups that have the same policy and start state, in one order."""
    place = {key: lane for lane, key in enumerate(other.keys)}
    pairs = [(lane, place[key]) for lane, key in enumerate(one.keys) if key in place]
    return [lane for lane, _ in pairs], [lane for _, lane in pairs]
