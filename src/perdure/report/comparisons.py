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
