"""Figure 2-2: success along the stages of each task, one curve for each release strategy."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from perdure.home.benchmark.tasks import get_task
from perdure.home.evaluate.page import words
from perdure.report import theme, wording
from perdure.report.axes import Axis
from perdure.report.curves import Curve, curve_chart
from perdure.report.render import Figure
from perdure.studies.placement.names import RELEASE_STRATEGIES, SPLITS, TITLES
from perdure.studies.placement.results import Results, Row, chosen, strategy_and_world

SHOWN = ("rl", "delta-200", "stop", "ik")


def stage_figures(results: Results) -> Iterator[Figure]:
    """Yield a figure for each task and split, drag only."""
    for split in SPLITS:
        for task in TITLES:
            found = chosen(results.rows, split, "drag", task)
            rows = [row for row in found if strategy_and_world(row)[0] in SHOWN]
            if rows:
                yield _figure(rows, split, task)


def _figure(rows: list[Row], split: str, task: str) -> Figure:
    names = words.stages(get_task(task))
    sample = wording.sample([row["episodes"] for row in rows], "episode")
    return Figure(
        f"figure-2-2-{split}-{task.replace('_', '-')}",
        "Success per stage",
        curve_chart(
            [_curve(row) for row in rows],
            Axis("stage of the task, in order", names=names),
            Axis(f"share of episodes that reached it ({sample})", percent=True),
            width=theme.WIDE,
        ),
        f"Apartments with {SPLITS[split]}, drag only. Every placement so far is goal-stabilizing. Bars at "
        "the right, for the last stage: 95 % Student t intervals over the training seeds.",
        heading=TITLES[task],
        wide=True,
    )


def _curve(row: Row) -> Curve:
    """Return the curve of a strategy; only the last stage has an interval."""
    strategy, success = strategy_and_world(row)[0], row["stabilizing"]
    means = np.array(list(row["stages"]["stabilizing"].values()))
    bounds = np.full((2, len(means)), np.nan)
    if row["seeds"]["train"] > 1:
        bounds[:, -1] = success["lower"], success["upper"]
    look = theme.style(RELEASE_STRATEGIES.index(strategy))
    x = np.arange(len(means), dtype=np.float64)
    return Curve(words.describe(strategy), x, means, look, bounds[0], bounds[1], marked=True, intervals="last")
