"""The sentence on top: what became of the lanes that did best."""

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
    going = float(group.going.mean())
    return (
        f"{group.task} \u00b7 {group.label}: {wording.share(going)} of {wording.count(group.lanes, 'lane')} still go "
        f"after {wording.whole(float(group.test_horizon))} steps; {wording.horizon(group.train_horizon)}."
    )
