"""Charts of success: the task's, both ways of counting, and how it shrinks from stage to stage (figure 2-2)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from perdure.home.evaluate.outcomes import COUNTINGS, Counting
from perdure.home.evaluate.page.comparison import Comparison, listed
from perdure.report.charts import Axis, Chart, FloatArray, Series
from perdure.report.palette import FADED, category
from perdure.report.statistics import TRAINING_SEEDS

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
        series=(*map(points, COUNTINGS), *filter(None, [_seed_points(comparison)])),
        row_lines=3,
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
    """What error bars are: 95 % intervals, over which units and by which method, for each arm."""
    methods: dict[tuple[str, str], list[str]] = {}
    for arm in comparison.arms:
        row = comparison.final(arm, "latched")
        methods.setdefault((str(row["units"]), str(row["method"])), []).append(arm)
    parts = []
    for (units, method), arms in methods.items():
        which = "" if len(methods) == 1 else f" of {listed(arms)}"
        seeds = units == TRAINING_SEEDS
        over = "training seeds" if seeds else "episodes of one training seed, silent on other seeds"
        parts.append(f"{what}{which}: 95 % intervals over {over} ({method}).")
    return " ".join(parts)


def unequal_note(comparison: Comparison) -> str:
    """A warning where the arms did not run the same episodes from the same start poses; else nothing."""
    ran = [set(comparison.episodes[arm].select("eval_seed", "index").rows()) for arm in comparison.arms]
    if all(each == ran[0] for each in ran):
        return ""
    counts = listed([f"{arm} {len(each)}" for arm, each in zip(comparison.arms, ran, strict=True)])
    return f" The arms ran different episodes ({counts}): see the table of the same episodes under two arms."


def _bounds(row: dict[str, float]) -> tuple[float, float]:
    return row["lower"], row["upper"]


def _seed_points(comparison: Comparison) -> Series | None:
    """The goal-stabilizing success of every training seed; None where no arm has several."""
    x, y = [], []
    for place, arm in enumerate(comparison.arms):
        seeds = comparison.episodes[arm].group_by("train_seed").agg(_share()).sort("train_seed")["share"].to_list()
        if len(seeds) > 1:
            x += seeds
            y += [place + 0.26] * len(seeds)
    if not x:
        return None
    return Series("each training seed", np.array(x), np.array(y), category(0), line=False, points=True, hollow=True)


def _share() -> pl.Expr:
    import polars as pl

    return pl.col("stabilizing").mean().alias("share")


def _stage_bounds(table: pl.DataFrame) -> tuple[FloatArray, FloatArray]:
    bounds = np.array([_bounds(row) for row in table.iter_rows(named=True)])
    return bounds[:, 0], bounds[:, 1]
