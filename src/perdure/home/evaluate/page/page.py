"""The page of the home benchmark: figures and tables of every task, and each figure as PNG beside it."""

from __future__ import annotations

import html
import os
from dataclasses import replace
from pathlib import Path

from perdure.home.evaluate.outcomes import COUNTINGS, Analysis
from perdure.home.evaluate.page import tables
from perdure.home.evaluate.page.cast import Cast
from perdure.home.evaluate.page.comparison import Comparison, comparisons, listed, percent
from perdure.home.evaluate.page.failures import mode_chart, outcome_chart
from perdure.home.evaluate.page.placements import MEASURES, kind_chart, release_chart, shape_chart
from perdure.home.evaluate.page.success import final_chart, stage_chart
from perdure.report import document
from perdure.report.charts import Chart
from perdure.report.png_renderer import render_png
from perdure.runs import write_whole

PAGE = "report.html"
METHOD = """A task plan runs skills one after the other, whatever became of the last one, from the same episodes and
start poses under every placing arm. <em>Latched</em> counts as the benchmark does: a stage that was reached stays
reached. <em>Goal-stabilizing</em> counts as the thesis does: from the end of its place to the end of the episode and of
the settling time after it, the object is in its goal and out of the hand at every step. Every number comes from the
logs alone; nothing is simulated for this page."""


def write_page(analysis: Analysis, out: str | os.PathLike[str], command: str, cast: Cast | None = None) -> Path:
    """Writes `report.html`, which needs no network, and its figures as PNG.

    Args:
        analysis: From `analyse`; several tasks, splits and arms may be in it.
        out: A folder; made if it is missing.
        command: What made the page; shown so that a reader can repeat it.
        cast: Who acted, from `read_cast`; the page says "not recorded" without it.

    Returns:
        The page.

    Raises:
        OSError: The folder cannot be written.
    """
    folder, parts, cast = Path(out), [], cast or Cast()
    folder.mkdir(parents=True, exist_ok=True)
    for comparison in comparisons(analysis):
        charts = make_charts(comparison)
        for chart in charts:
            write_whole(folder / f"{chart.name}.png", render_png(chart, _title(comparison)))
        parts += [document.header(_title(comparison), verdict(comparison)), document.figures(charts)]
        parts += _tables(comparison, cast)
    parts.append(document.text("How to read this", METHOD))
    others = [each for each in cast.commands if each != command]
    if others:
        made = "".join(f"<pre>{html.escape(each)}</pre>" for each in others)
        parts.append(f"<section><h2>The logs were made by</h2>{made}</section>")
    return write_whole(folder / PAGE, document.page("perdure home: does it stay?", parts, command))


def make_charts(comparison: Comparison) -> list[Chart]:
    """All charts of one task and split; those with nothing to show are left out. Names are unique in the page."""
    found: list[Chart | None] = [final_chart(comparison), shape_chart(comparison), kind_chart(comparison)]
    found += [outcome_chart(comparison), stage_chart(comparison)]
    found += [mode_chart(comparison, counting) for counting in reversed(COUNTINGS)]
    found += [release_chart(comparison, measure) for measure in MEASURES]
    return [replace(chart, name=f"{comparison.name}-{chart.name}") for chart in found if chart is not None]


def verdict(comparison: Comparison) -> str:
    """One sentence: how often the whole task succeeded and stayed so, and what the benchmark counts."""
    lasting, latched = (
        [percent(comparison.final(arm, counting)["mean"]) for arm in comparison.arms]
        for counting in ("stabilizing", "latched")
    )
    arms = listed([f"{arm} {share}" for arm, share in zip(comparison.arms, lasting, strict=True)])
    return f"Solved, and everything stayed: {arms}. The benchmark counts {listed(latched)}."


def _title(comparison: Comparison) -> str:
    return f"{comparison.task} {comparison.split}"


def _tables(comparison: Comparison, cast: Cast) -> list[str]:
    return [
        tables.success_table(comparison),
        tables.paired_table(comparison),
        tables.mode_table(comparison),
        tables.placement_table(comparison),
        tables.release_table(comparison),
        tables.hand_over_table(comparison, cast),
        tables.cast_table(comparison, cast),
    ]
