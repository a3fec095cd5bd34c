"""The sentence on top: how the group with the highest return did."""

from __future__ import annotations

from collections.abc import Sequence

from perdure.report import wording
from perdure.report.estimates import Estimate


def verdict(estimates: Sequence[Estimate]) -> str:
    """Say in one sentence how the group with the highest final return holds, and what the training horizon was.

    Args:
        estimates: The groups of one task, at least one.
    """
    best = max(estimates, key=lambda item: item.final_return)
    group = best.group
    were = "was" if group.lanes == 1 else "were"
    return (
        f"{group.task}, {group.label}: {int(group.productive.sum())} of {wording.count(group.lanes, 'episode')} {were} "
        f"still running and productive after {wording.whole(float(group.test_horizon))} steps; "
        f"{wording.horizon(group.train_horizon)}."
    )
