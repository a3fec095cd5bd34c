"""The report: one HTML page that needs no network, and each figure as PNG beside it."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import polars as pl

from perdure.report import document
from perdure.report.charts import Chart
from perdure.report.estimates import Estimate, estimate_group
from perdure.report.figures import make_charts
from perdure.report.groups import make_groups, tasks_of
from perdure.report.png_renderer import render_png
from perdure.report.schema import check_table, read_table
from perdure.report.table import HEADINGS, make_rows
from perdure.report.verdict import verdict
from perdure.runs import write_whole

PAGE = "report.html"
SEED = 0
"""Of the bootstrap's generator: the same table, the same intervals."""
METHOD = """Every policy and clock ran closed loop from the same start states. The lanes of one training run are
averaged first; training runs are the units of the 95 % intervals. With one training run its lanes are the units, and
the interval is labelled “evaluation seeds only”: it says nothing about training again. Fewer than ten units give
Student's t interval, more a percentile bootstrap (2,000 resamples); a share of the lanes of one training run gives
Wilson's score interval. <em>Going</em> means alive and still earning at least a tenth, per step, of what the lane
earned in its first tenth. <em>Stuck</em> means that some window of 1,000 steps earned less than a tenth of the lane's
first 1,000."""


def estimate_table(frame: pl.DataFrame) -> dict[str, list[Estimate]]:
    """Every group's estimates by task, in the table's order; the generator is seeded with SEED."""
    rng = np.random.default_rng(SEED)
    groups = make_groups(frame)
    return {task: [estimate_group(group, rng) for group in groups if group.task == task] for task in tasks_of(groups)}


def summary_text(frame: pl.DataFrame) -> str:
    """The verdict and the table as plain text, for a terminal.

    Raises:
        ReportError: The frame does not fit the schema.
    """
    check_table(frame, "The table")
    parts = []
    for estimates in estimate_table(frame).values():
        rows = [HEADINGS, *(row.cells for row in make_rows(estimates))]
        widths = [max(len(row[i]) for row in rows) for i in range(len(HEADINGS))]
        lines = ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows]
        parts.append("\n".join([verdict(estimates), "", *lines]))
    return "\n\n".join(parts)


def write_report(table: pl.DataFrame | str | os.PathLike[str], out: str | os.PathLike[str], command: str) -> Path:
    """Write the page and the PNG files.

    Args:
        table: An extrapolation table, or its file.
        out: A folder; made if it is missing.
        command: What made the table; shown so that a reader can repeat it.

    Returns:
        The page.

    Raises:
        ReportError: The table does not fit the schema.
        OSError: The folder cannot be written.
    """
    if not isinstance(table, pl.DataFrame):
        table, _ = read_table(table)
    check_table(table, "The table to report")
    folder = Path(out)
    folder.mkdir(parents=True, exist_ok=True)
    sections = []
    for task, estimates in estimate_table(table).items():
        charts = make_charts(estimates)
        for chart in charts:
            write_whole(folder / f"{chart.name}.png", render_png(chart, task))
        sections.append(_section(task, estimates, charts))
    return write_whole(folder / PAGE, _page(sections, command))


def _page(sections: Sequence[str], command: str) -> str:
    return document.page("perdure: does it hold?", [*sections, document.text("How this was made", METHOD)], command)


def _section(task: str, estimates: Sequence[Estimate], charts: Sequence[Chart]) -> str:
    rows = make_rows(estimates)
    over = " or ".join(sorted({row.intervals for row in rows}))
    lanes = document.table("All lanes", HEADINGS, [row.cells for row in rows], f"Intervals over {over}.")
    return document.header(task, verdict(estimates)) + document.figures(charts) + lanes
