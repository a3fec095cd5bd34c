"""Curtailed sampling: an evaluation ends as soon as the episodes that remain cannot make every policy hold.

A policy holds if nine in ten of its episodes do. Once too many have failed, no result of the others changes that, so
the verdict *does not hold* is that of the full evaluation: nothing is estimated, and no error is added. The cheapest
episodes come first. Where everything holds, every episode runs, and the table is that of an evaluation without this.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from perdure.evaluate.options import Condition
from perdure.report.estimates import cannot_hold
from perdure.report.groups import make_groups
from perdure.report.schema import EarlyStop

if TYPE_CHECKING:
    import polars as pl

FIRST_SEEDS = 8
"""Start states that are tried first, then twice as many, and so on: few starts of processes, few needless episodes."""


def parts(conditions: Sequence[Condition]) -> Iterator[list[Condition]]:
    """Yield growing parts of an evaluation: more and more start states of its shortest episodes.

    All conditions with all their start states are not among the parts.
    """
    shortest = min(each.steps for each in conditions)
    short = [each for each in conditions if each.steps == shortest]
    most = max(each.eval_seeds for each in short)
    seeds = FIRST_SEEDS
    while seeds < most:
        yield [replace(each, eval_seeds=min(each.eval_seeds, seeds)) for each in short]
        seeds *= 2
    if len(short) < len(conditions):
        yield short


def find_stop(
    frame: pl.DataFrame, part: Sequence[Condition], conditions: Sequence[Condition], planned: int
) -> EarlyStop | None:
    """Return why no remaining episode can make every policy hold; None while they can.

    Args:
        frame: Judged episodes.
        part: Their conditions.
        conditions: All conditions of the evaluation.
        planned: Episodes of the evaluation.
    """
    seen = {each.label: each.eval_seeds for each in part}
    asked = {each.label: each.eval_seeds for each in conditions}
    for group in make_groups(frame):
        in_all = group.episodes // seen[group.disturbance] * asked[group.disturbance]
        missed = cannot_hold(group, in_all)
        if missed:
            ran = frame.filter(frame["step"] == frame["test_horizon"]).height
            reason = (
                f"{missed} of {group.episodes} episodes of {group.label} do not hold, "
                f"so fewer than nine in ten of {in_all} can"
            )
            return EarlyStop(ran, planned, reason)
    return None
