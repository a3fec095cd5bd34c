"""Compare clocks of one policy by paired differences on common start states."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby

import numpy as np

from perdure.report import wording
from perdure.report.estimates import Estimate
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
    """Compare each clock with the first one of the same line.

    Args:
        estimates: Groups of one task in the order of `make_groups`; lanes of two groups of a line are in one order.
        rng: For bootstrap intervals.
        how: Method and confidence of the intervals.

    Returns:
        Cells under CLOCK_HEADINGS, one row for each clock but the first.
    """
    rows: list[tuple[str, ...]] = []
    for line, items in groupby(estimates, key=lambda item: item.group.line):
        first, *others = [item.group for item in items]
        for group in others:
            if group.lanes != first.lanes:
                continue
            difference = group.returns[:, -1] - first.returns[:, -1]
            found = mean_interval(difference, group.runs, rng, how)
            low, high = float(found.lower), float(found.upper)
            rows.append(
                (
                    line,
                    group.clock,
                    first.clock,
                    wording.quantity(float(found.estimate)),
                    "\u2013" if np.isnan(low) else f"{wording.quantity(low)} to {wording.quantity(high)}",
                    f"{int((difference > 0).sum())} of {wording.count(group.lanes, 'episode')}",
                    f"{found.label} ({found.method}, {wording.count(found.count, 'unit')})",
                )
            )
    return rows


def best_clocks(estimates: Sequence[Estimate], rng: np.random.Generator, how: Bootstrap = DEFAULT) -> list[str]:
    """Return one sentence for each line with several clocks: the best one, and those as good as it.

    The best clock has the largest share of episodes that hold, and of those the highest mean return. Another one is as
    good if its verdict is the same and the interval of its paired difference of the return contains 0.

    Args:
        estimates: As in `compare_clocks`.
        rng: For bootstrap intervals.
        how: Method and confidence of the intervals.
    """
    sentences = []
    for line, items in groupby(estimates, key=lambda item: item.group.line):
        clocks = list(items)
        if len(clocks) < 2 or len({item.group.lanes for item in clocks}) > 1:
            continue
        best = max(clocks, key=lambda item: (float(item.verdict.share.estimate), item.final_return))
        if not float(best.verdict.share.estimate):
            sentences.append(f"No episode of {line} holds under any of {len(clocks)} clocks.")
            continue
        same = [item.group.clock_words for item in clocks if item is not best and _as_good(item, best, rng, how)]
        listed = ", ".join(same) if len(same) <= _MOST_LISTED else wording.count(len(same), "clock")
        sentences.append(
            f"Best clock of {line} on these start states: {best.group.clock_words}."
            + (f" Not distinguishable from it (return, 95 %): {listed}." if same else "")
            + " Confirm it on others (--first-eval-seed)."
        )
    return sentences


def _as_good(item: Estimate, best: Estimate, rng: np.random.Generator, how: Bootstrap) -> bool:
    if item.verdict.label != best.verdict.label:
        return False
    difference = item.group.returns[:, -1] - best.group.returns[:, -1]
    found = mean_interval(difference, item.group.runs, rng, how)
    low, high = float(found.lower), float(found.upper)
    return bool(np.isnan(low) or low <= 0.0 <= high)
