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
    "verdict",
    "hold",
    "running",
    "ever idle",
    "level",
    "half failed by",
    "episodes that",
)


@dataclass(frozen=True)
class Row:
    """One line of the table, as text. Fields follow HEADINGS."""

    cells: tuple[str, ...]
    intervals: str
    """What the intervals are over."""


def make_rows(estimates: Sequence[Estimate]) -> tuple[Row, ...]:
    """Return one row for each estimate, in their order."""
    return tuple(_row(item) for item in estimates)


def _row(item: Estimate) -> Row:
    group, returns = item.group, item.returns
    low, high = float(returns.lower[-1]), float(returns.upper[-1])
    interval = "\u2013" if np.isnan(low) else f"{wording.quantity(low)} to {wording.quantity(high)}"
    counts = Counter(group.verdicts)
    hold = float(item.final_hold.estimate)
    cells = (
        group.line,
        group.clock,
        f"{group.lanes:,}",
        wording.quantity(item.final_return),
        interval,
        item.verdict.label,
        wording.quantity(hold),
        wording.share(float(group.alive[:, -1].mean())),
        wording.share(float(group.ever_idle.mean())),
        wording.quantity(float(np.nanmean(group.level))) if np.isfinite(group.level).any() else "\u2013",
        wording.whole(group.half_failed_by) if np.isfinite(group.half_failed_by) else "\u2013",
        ", ".join(f"{verdict} {number}" for verdict, number in counts.most_common()),
    )
    return Row(cells, f"{returns.label} ({returns.method}, {wording.count(returns.count, 'unit')})")
