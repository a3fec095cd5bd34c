"""The summary table: one row for each group of lanes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from perdure.report import wording
from perdure.report.estimates import Estimate

HEADINGS = (
    "policy",
    "clock",
    "episodes",
    "return",
    "95 % interval",
    "running",
    "productive",
    "median length",
    "stuck",
    "endings",
)


@dataclass(frozen=True)
class Row:
    """One line of the table, as text. Fields follow HEADINGS."""

    cells: tuple[str, ...]
    intervals: str
    """What the intervals are over."""


def make_rows(estimates: Sequence[Estimate]) -> tuple[Row, ...]:
    """One row for each estimate, in their order."""
    return tuple(_row(item) for item in estimates)


def _row(item: Estimate) -> Row:
    group, returns = item.group, item.returns
    low, high = float(returns.lower[-1]), float(returns.upper[-1])
    interval = "\u2013" if np.isnan(low) else f"{wording.quantity(low)} to {wording.quantity(high)}"
    reasons = Counter(group.end_reasons)
    cells = (
        group.line,
        group.clock,
        f"{group.lanes:,}",
        wording.quantity(item.final_return),
        interval,
        wording.share(float(group.alive[:, -1].mean())),
        wording.share(float(group.productive.mean())),
        wording.whole(float(np.median(group.end_steps))),
        wording.share(float((group.stuck_steps > 0).mean())),
        ", ".join(f"{number} {reason}" for reason, number in reasons.most_common()),
    )
    return Row(cells, f"{returns.label} ({returns.method}, {wording.count(returns.count, 'unit')})")
