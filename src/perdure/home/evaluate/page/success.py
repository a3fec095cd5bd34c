"""Charts of success: the task's, both ways of counting, and how it shrinks from stage to stage (figure 2-2)."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from perdure.home.evaluate.outcomes import COUNTINGS, Counting
from perdure.home.evaluate.page.comparison import Comparison, listed
from perdure.report.charts import Axis, Chart, FloatArray, Series
from perdure.report.palette import FADED, category

if TYPE_CHECKING:
    import polars as pl

WORDS: dict[Counting, str] = {"latched": "latched (benchmark)", "stabilizing": "goal-stabilizing (thesis)"}


def final_chart(comparison: Comparison) -> Chart:
    """Success of the whole task: a row for each arm, a point for each way of counting."""
    places = np.arange(len(comparison.arms), dtype=np.float64)

    def points(counting: Counting) -> Series:
        rows = [comparison.final(arm, counting) for arm in comparison.arms]
        means, bounds = np.array([row["mean"] for row in rows]), np.array([_bounds(row) for row in rows])
        latched = counting == "latched"
        return Series(
            label=WORDS[counting],
            x=means,
            y=places + (-0.14 if latched else 0.14),
            colour=FADED if latched else category(0),
            lower=bounds[:, 0],
            upper=bounds[:, 1],
            line=False,
            points=True,
            hollow=latched,
        )

    return Chart(
        name="success",
        title="Success of the whole task",
        x=Axis("share of episodes", percent=True, low=0.0, high=1.0),
        y=Axis("", rows=comparison.arms),
        series=tuple(map(points, COUNTINGS)),
        row_lines=2,
        note="Latched: a stage counts once its conditions hold, whatever follows. Goal-stabilizing: objects also stay. "
        + error_note(comparison)
        + unequal_note(comparison),
    )


def stage_chart(comparison: Comparison) -> Chart:
    """Success per stage: a curve for each arm and way of counting."""
    stages = tuple(stage.name for stage in comparison.home_task.stages)
    curves = []
    for arm, colour in zip(comparison.arms, comparison.colours, strict=True):
        for counting in reversed(COUNTINGS):
            table = comparison.stages[arm].filter(counting=counting)
            lasting = counting == "stabilizing"
            lower, upper = _stage_bounds(table)
            curves.append(
                Series(
                    label=f"{arm}, {WORDS[counting].partition(' ')[0]}",
                    x=np.arange(len(stages), dtype=np.float64),
                    y=table["mean"].to_numpy(),
                    colour=colour,
                    lower=lower if lasting else None,
                    upper=upper if lasting else None,
                    dash="solid" if lasting else "dot",
                    group=arm,
                    tag=arm if lasting else f"{arm}, latched",
                )
            )
    return Chart(
        name="stages",
        title="Success per stage",
        x=Axis("stage of the task, in order", rows=stages),
        y=Axis("share of episodes that reached it", percent=True, low=0.0, high=1.0),
        series=tuple(curves),
        note=f"Solid: every placement so far is goal-stabilizing. Dotted: latched. {error_note(comparison, 'Bands')}",
        wide=True,
    )


def error_note(comparison: Comparison, what: str = "Bars") -> str:
    """What error bars are: the standard error over runs; intervals over episodes where an arm has one run only."""
    runs = {arm: int(comparison.final(arm, "latched")["runs"]) for arm in comparison.arms}
    one = [arm for arm, count in runs.items() if count == 1]
    parts = []
    if len(one) < len(runs):
        counts = listed([f"{arm} {count}" for arm, count in runs.items() if count > 1])
        parts.append(f"{what}: standard error over runs (training x evaluation seeds; {counts}).")
    if one:
        who = "" if len(one) == len(runs) else f" of {listed(one)}"
        parts.append(f"{what}{who}: one run only, so a 95 % interval over its episodes; it is silent on other seeds.")
    return " ".join(parts)


def unequal_note(comparison: Comparison) -> str:
    """A warning where the arms did not run the same episodes from the same start poses; else nothing."""
    ran = [set(comparison.episodes[arm].select("eval_seed", "index").rows()) for arm in comparison.arms]
    if all(each == ran[0] for each in ran):
        return ""
    counts = listed([f"{arm} {len(each)}" for arm, each in zip(comparison.arms, ran, strict=True)])
    return f" The arms ran different episodes ({counts}): see the table of the same episodes under two arms."


def _bounds(row: dict[str, float]) -> tuple[float, float]:
    error = row["standard_error"]
    if math.isnan(error):
        return row["lower"], row["upper"]
    return row["mean"] - error, row["mean"] + error


def _stage_bounds(table: pl.DataFrame) -> tuple[FloatArray, FloatArray]:
    bounds = np.array([_bounds(row) for row in table.iter_rows(named=True)])
    return bounds[:, 0], bounds[:, 1]
