"""Write the report: one HTML page that works offline, and an image file of each figure."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import polars as pl

from perdure.report import document
from perdure.report.comparisons import CLOCK_HEADINGS, compare_clocks
from perdure.report.estimates import Estimate, estimate_group
from perdure.report.figures import make_figures
from perdure.report.groups import make_groups, tasks_of
from perdure.report.lanes import Lanes
from perdure.report.render import Figure, Format, javascript, save, unique
from perdure.report.schema import read_lanes
from perdure.report.table import HEADINGS, make_rows
from perdure.report.verdict import headline
from perdure.runs import write_atomic

PAGE = "report.html"
MOST_POINTS = 12
"""Policies and clocks whose evidence is written out."""
SEED = 0
"""Of the bootstrap's generator: the same table, the same intervals."""
METHOD = """Every policy ran closed loop under every clock from the same start states. The episodes of one training
run are averaged first; training runs are the units of the 95 % intervals. With one training run its episodes are the
units, and the interval is labeled “evaluation seeds only”: it says nothing about training again. Fewer than ten units
give Student's t interval, which covers the mean of normal scores in 95 of 100 cases whatever their number. Ten or more
give a percentile bootstrap (2,000 resamples), which covers it in about 90 (ten units) to 93 (24 units). A share of the
episodes of one training run gives Wilson's score interval. <em>Clock</em>: what the policy was told about time;
constant(C): always C steps to go; countdown(T): the steps to go until T; periodic(C): a countdown from C, again and
again. <em>Running</em>: not ended by the environment. <em>Hold score</em>: (rate - idle) / (reference - idle), where
rate is the reward per step, reference the rate of the policy itself within its training horizon, and idle the better
of zero and random actions, measured. Rates are per step before the end, so an early fall does not lower a score; falls
are counted as falls, an ended episode earns nothing more of its return, and it counts 0 in the mean hold score.
<em>Level</em>: the same score with a published policy of the task as reference. An episode <em>holds</em> if it runs
to the end with a mean hold score of at least 0.75 in the last tenth of the steps. It <em>decays</em> below that, unless
chance explains it, and <em>fails silently</em> below 0.25. After a pause in which it earned no more than an idle
robot, five times that pause is averaged. It <em>falls</em> if the environment ends it, and <em>diverges</em> if the
simulation blows up. A policy <em>never worked</em> if it does no better than idle within its own training horizon. A
policy holds if at least nine in ten episodes do; otherwise it has the commonest verdict of its episodes. <em>Ever
idle</em>: episodes in which two windows in a row scored below 0.25. <em>Half failed by</em>: median of the Kaplan-Meier
curve."""


Estimates = dict[str, list[Estimate]]
"""Every group's estimates by task, in the table's order."""
Table = pl.DataFrame | str | os.PathLike[str]


def estimate_table(table: pl.DataFrame | Sequence[Lanes]) -> Estimates:
    """Estimate every group of a table, or of its lanes; the generator is seeded with SEED.

    Raises:
        ReportError: The table does not fit the schema.
    """
    rng = np.random.default_rng(SEED)
    groups = make_groups(table)
    return {task: [estimate_group(group, rng) for group in groups if group.task == task] for task in tasks_of(groups)}


def _estimates(table: Table | Estimates) -> Estimates:
    if isinstance(table, dict):
        return table
    return estimate_table(table if isinstance(table, pl.DataFrame) else read_lanes(table)[0])


def summary_text(table: Table | Estimates) -> str:
    """Return the verdicts and the table of numbers as plain text, for a terminal.

    Args:
        table: An extrapolation table, its file, or what `estimate_table` made of it.

    Raises:
        ReportError: The table does not fit the schema.
    """
    parts = []
    for estimates in _estimates(table).values():
        rows = [HEADINGS, *(row.cells for row in make_rows(estimates))]
        widths = [max(len(row[i]) for row in rows) for i in range(len(HEADINGS))]
        lines = ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows]
        points = [f"  {item.verdict.sentence}" for item in estimates[:MOST_POINTS]]
        parts.append("\n".join([_headline(estimates), *points, "", *lines]))
    return "\n\n".join(parts)


def _headline(estimates: Sequence[Estimate]) -> str:
    return headline([item.verdict for item in estimates])


def write_report(
    table: Table | Estimates,
    out: str | os.PathLike[str],
    command: str,
    formats: Sequence[Format] = ("png",),
) -> Path:
    """Write the page, and each figure as a file beside it.

    Args:
        table: An extrapolation table, its file, or what `estimate_table` made of it.
        out: A folder; made if it is missing.
        command: What made the table; shown so that a reader can repeat it.
        formats: Of the files: "png", "svg", "pdf"; () writes the page alone.

    Returns:
        The page.

    Raises:
        ReportError: The table does not fit the schema, or a format is unknown.
        OSError: The folder cannot be written.
    """
    by_task = _estimates(table)
    folder = Path(out)
    folder.mkdir(parents=True, exist_ok=True)
    javascript()  # bundled before figures are drawn: the other way round takes 60 MB more
    sections: list[str] = []
    taken: set[str] = set()
    for task, estimates in by_task.items():
        figures = unique(make_figures(estimates), taken)
        save(figures, folder, formats)
        sections.append(_section(task, estimates, figures))
    return write_atomic(folder / PAGE, _page(sections, command))


def _page(sections: Sequence[str], command: str) -> str:
    return document.page("perdure: does it hold?", [*sections, document.text("How this was made", METHOD)], command)


def _section(task: str, estimates: Sequence[Estimate], figures: Sequence[Figure]) -> str:
    rows = make_rows(estimates)
    over = " or ".join(sorted({row.intervals for row in rows}))
    numbers = document.table(
        "All policies and clocks", HEADINGS, [row.cells for row in rows], f"Intervals over {over}."
    )
    points = [item.verdict.sentence for item in estimates[:MOST_POINTS]]
    head = document.header(task, _headline(estimates), points)
    return head + document.figures(figures) + numbers + _comparisons(estimates)


def _comparisons(estimates: Sequence[Estimate]) -> str:
    rows = compare_clocks(estimates, np.random.default_rng(SEED))
    if not rows:
        return ""
    note = "Differences of the final return between episodes from the same start state, averaged within training runs."
    return document.table("Clocks compared", CLOCK_HEADINGS, rows, note)
