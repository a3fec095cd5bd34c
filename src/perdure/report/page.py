"""Write the report: one HTML page that works offline, and an image file of each figure."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import polars as pl

from perdure.report import document
from perdure.report.comparisons import CLOCK_HEADINGS, best_clocks, compare_clocks
from perdure.report.estimates import Estimate, estimate_group
from perdure.report.figures import make_figures
from perdure.report.groups import make_groups, tasks_of
from perdure.report.lanes import Lanes
from perdure.report.render import Figure, Format, javascript, save, unique
from perdure.report.schema import read_lanes
from perdure.report.table import HEADINGS, RUN_HEADINGS, make_rows, make_run_rows
from perdure.report.verdict import headline
from perdure.runs import write_atomic

PAGE = "report.html"
MOST_POINTS = 12
"""Most policies and clocks for which the text gives the evidence."""
SEED = 0
"""Seed of the bootstrap: the same table gives the same intervals."""
METHOD = """Every policy ran closed loop under every clock from the same start states. Intervals are 95 % intervals
over training runs: the episodes of one training run are averaged first. With one training run the episodes are the
units, and the interval is labeled “evaluation seeds only”: it says nothing about other training runs. Fewer than ten
units give Student's t interval, which covers the mean of normal scores in 95 of 100 cases whatever their number. Ten
or more give a percentile bootstrap (2,000 resamples), which covers it in about 90 (ten units) to 93 (24 units). A
share of the episodes of one training run gives Wilson's score interval."""
WORDS = """<em>Lane</em>: one deployed episode, from one start state under one clock.<br>
<em>Clock</em>: sets the time-to-go input. constant(C): always C steps to go; countdown(T): the steps to go until T;
periodic(C): a countdown from C, again and again.<br>
<em>Running</em>: not ended by the environment.<br>
<em>Hold score</em>: (rate - idle) / (reference - idle). Rate is the reward per step before the end, reference the rate
of the policy itself within its training horizon, and idle the measured rate of zero or of random actions, whichever is
higher. An early fall does not lower the rate; an ended episode counts as 0 in the mean hold score, and its return stays
constant.<br>
<em>Level</em>: the same score with a published policy of the task as reference.<br>
<em>Holds</em>: the episode runs to the end, with a mean hold score of at least 0.75 in the last tenth of the steps.
After a pause with a score below 0.25, the mean is taken over five times the pause.<br>
<em>Decays</em>: the score is below 0.75, and chance does not explain it. <em>Fails silently</em>: it is below 0.25.<br>
<em>Falls</em>: the environment ends the episode. <em>Diverges</em>: the simulation becomes invalid.<br>
<em>Never worked</em>: the policy gains too little over an idle robot within its own training horizon; where every
step pays the same, its episodes end too early there.<br>
<em>Verdict on a policy</em>: it holds if at least nine in ten episodes hold; otherwise the most common outcome.<br>
<em>Ever idle</em>: episodes in which two consecutive windows scored below 0.25.<br>
<em>Half failed by</em>: median of the Kaplan-Meier curve."""


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
        points = [f"  {point}" for point in _points(estimates)]
        parts.append("\n".join([_headline(estimates), *points, "", *lines]))
    return "\n\n".join(parts)


def _headline(estimates: Sequence[Estimate]) -> str:
    return headline([item.verdict for item in estimates])


def _points(estimates: Sequence[Estimate]) -> list[str]:
    """Return the sentences under the headline: the evidence for each verdict, and the best clock of each policy."""
    clocks = best_clocks(estimates, np.random.default_rng(SEED))
    more = len(estimates) - MOST_POINTS
    rest = [f"{more} more policies and clocks are in the table."] if more > 0 else []
    return [*(item.verdict.sentence for item in estimates[:MOST_POINTS]), *rest, *clocks]


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
    return document.page(
        "perdure: does it hold?",
        [*sections, document.text("Words", WORDS), document.text("How this was made", METHOD)],
        command,
    )


def _section(task: str, estimates: Sequence[Estimate], figures: Sequence[Figure]) -> str:
    rows = make_rows(estimates)
    over = " or ".join(sorted({row.intervals for row in rows}))
    numbers = document.table(
        "All policies and clocks", HEADINGS, [row.cells for row in rows], f"Intervals over {over}."
    )
    head = document.header(task, _headline(estimates), _points(estimates))
    return head + document.figures(figures) + numbers + _training_runs(estimates) + _comparisons(estimates)


def _training_runs(estimates: Sequence[Estimate]) -> str:
    rows = make_run_rows(estimates)
    if not rows:
        return ""
    note = (
        "Training runs of one method often differ more than methods do. A run that you choose here was chosen on these "
        "start states: confirm it on others (--first-eval-seed)."
    )
    return document.table("Training runs", RUN_HEADINGS, rows, note)


def _comparisons(estimates: Sequence[Estimate]) -> str:
    rows = compare_clocks(estimates, np.random.default_rng(SEED))
    if not rows:
        return ""
    note = "Differences of the final return between episodes from the same start state, averaged within training runs."
    return document.table("Clocks compared", CLOCK_HEADINGS, rows, note)
