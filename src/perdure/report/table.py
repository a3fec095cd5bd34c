"""The summary tables: one row for each group of lanes, and one for each training run of a group."""

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

RUN_HEADINGS = ("policy", "clock", "training seed", "episodes", "return", "verdict", "hold", "episodes that")


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
        _outcomes(counts),
    )
    return Row(cells, f"{returns.label} ({returns.method}, {wording.count(returns.count, 'unit')})")


def make_run_rows(estimates: Sequence[Estimate]) -> list[tuple[str, ...]]:
    """Return one row of cells for each training run of the groups that have several; they follow RUN_HEADINGS."""
    return [
        _run_row(item, seed, label)
        for item in estimates
        for seed, label in sorted(item.verdict.by_training_seed.items())
    ]


def _run_row(item: Estimate, seed: int, label: str) -> tuple[str, ...]:
    group = item.group
    mine = group.train_seeds == seed
    counts = Counter(verdict for verdict, chosen in zip(group.verdicts, mine, strict=True) if chosen)
    hold = group.final_hold[mine]
    return (
        group.line,
        group.clock,
        str(seed),
        f"{int(mine.sum()):,}",
        wording.quantity(float(group.returns[mine, -1].mean())),
        label,
        wording.quantity(float(np.nanmean(hold))) if np.isfinite(hold).any() else "\u2013",
        _outcomes(counts),
    )


def _outcomes(counts: Counter[str]) -> str:
    return ", ".join(f"{verdict} {number}" for verdict, number in counts.most_common())
