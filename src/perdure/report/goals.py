"""Tasks with a goal: which verdict they get, and how often, when and how long their episodes are at the goal, in words.

A reached goal that ends the episode is a verdict of its own. Where episodes go on, successes are counted as in
ManiSkill-HAB: once, at the end, and the longest stay. And measures of a robot's walk: does it walk straight?
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from perdure.report import wording
from perdure.report.schema import GOALS, MEASURES

if TYPE_CHECKING:
    from perdure.report.groups import Group

REACHES, MISSES = "reaches its goal", "misses its goal"
"""Verdicts in a task that ends episodes at the goal: of those, and of others that neither fall nor diverge."""
GOOD = ("holds", REACHES)
STRAIGHT = 10.0
"""A robot that turns away from its commanded heading by more does not walk straight [degrees a minute]."""
WALKS = (
    *("turns {} degrees a minute from its commanded heading", "drifts {} m a minute from its commanded path"),
    *("misses its commanded velocity by {} m/s", "its motors work {} J/m"),
)
SUCCESSES = [
    pl.when(pl.col(name).is_nan().all().over("task")).then(name).otherwise(pl.col(name).fill_nan(none)).alias(name)
    for name, none in GOALS.items()
]
"""If the environment reports successes in some episodes, those of which it says nothing have none."""


def success_cells(group: Group) -> dict[str, str]:
    """Return what a table shows of a group, by heading; {} where the environment reports no successes."""
    first, stay, at_end = (group[name] for name in GOALS)
    if np.isnan(first).any():
        return {}
    once, end = (wording.share(float(each.mean())) for each in (np.isfinite(first), at_end))
    return {"success once": once, "success at end": end, "longest stay": wording.whole(float(np.median(stay)))}


def reaching(group: Group) -> str:
    """Return "reaches its goal in 18 of 20 episodes, after 43 steps (median, 1.72 s)"."""
    return f"{REACHES} in {_counted(group, group.verdicts.count(REACHES))}"


def goal_evidence(group: Group, label: str) -> Iterator[str]:
    """Yield what is to be said of the goal beside the verdict."""
    first, stay, at_end = (group[name] for name in GOALS)
    if label == REACHES:
        return
    if (step := group.one_end) is not None:
        yield f"every episode ends at step {step:,}: the environment may report its time limit as a termination"
    if {REACHES, MISSES} & {*group.verdicts}:
        yield reaching(group)
    elif not np.isnan(first).any():
        once = int(np.isfinite(first).sum())
        yield f"success once in {_counted(group, once)}" + (f", at the end in {at_end.sum():.0f}" if once else "")
        if once:
            middle, kept = np.quantile(stay, (0.5, 0.1), method="lower")
            yield f"longest stay {middle:,.0f} steps (median), {kept:,.0f} or more in nine of ten"


def _counted(group: Group, number: int) -> str:
    """Return how many episodes these are, and after how many steps an episode has its first success."""
    counted, steps = f"{number} of {wording.count(group.episodes, 'episode')}", group["goal_first_step"]
    if not np.isfinite(steps).any():
        return counted
    middle = np.median(steps[np.isfinite(steps)])
    seconds = "" if np.isnan(step := group["step_seconds"][0]) else f", {middle * step:.3g} s"
    return f"{counted}, after {middle:,.0f} steps (median{seconds})"


def medians(group: Group) -> dict[str, float]:
    """Return the median of each of `MEASURES` over the episodes that have it, by name."""
    known = {name: group[name][np.isfinite(group[name])] for name in MEASURES}
    return {name: float(np.median(values)) for name, values in known.items() if len(values)}


def walk_evidence(group: Group) -> Iterator[str]:
    """Yield what is to be said of the walk beside the verdict."""
    found = medians(group)
    for name, words in zip(MEASURES, WALKS, strict=True):
        if name in found:
            crooked = name == "heading_error" and found[name] > STRAIGHT
            yield words.format(wording.quantity(found[name])) + (": it does not walk straight" if crooked else "")
