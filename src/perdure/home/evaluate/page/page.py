"""The page of the home benchmark: figures and tables of every task, and each figure as a picture file beside it."""

from __future__ import annotations

import html
import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from perdure.home.evaluate.outcomes import COUNTINGS, Analysis
from perdure.home.evaluate.page import tables, words
from perdure.home.evaluate.page.assignment import PolicyAssignment
from perdure.home.evaluate.page.comparison import Comparison, comparisons, listed, percent
from perdure.home.evaluate.page.failure_modes import mode_figure, outcome_figure
from perdure.home.evaluate.page.placements import MEASURES, kind_figure, release_figure, shape_figure
from perdure.home.evaluate.page.success import final_figure, stage_figure
from perdure.report import document
from perdure.report.render import Figure, Format, save, slug, unique
from perdure.runs import write_atomic

PAGE = "report.html"
METHOD = """A task plan runs skills one after the other, whatever became of the last one, from the same episodes and
start poses under every release strategy. <em>Latched</em> counts as the benchmark does: a stage that was reached stays
reached. <em>Goal-stabilizing</em> counts as the thesis does: from the end of its place to the end of the episode and of
the settling time after it, the object is in its goal and out of the hand at every step. Every number comes from the
logs alone; nothing is simulated for this page."""


def write_page(
    analysis: Analysis,
    out: str | os.PathLike[str],
    command: str,
    assignment: PolicyAssignment | None = None,
    formats: Sequence[Format] = ("png",),
) -> Path:
    """Write `report.html`, which needs no network, and each figure as a file beside it.

    Args:
        analysis: From `analyze`; several tasks, splits and strategies may be in it.
        out: A folder; made if it is missing.
        command: What made the page; shown so that a reader can repeat it.
        assignment: The policies, from `read_assignment`; the page says "not recorded" without it.
        formats: Of the files: "png", "svg", "pdf"; () writes the page alone.

    Returns:
        The page.

    Raises:
        ReportError: An unknown format.
        OSError: The folder cannot be written.
    """
    folder, parts, assignment = Path(out), list[str](), assignment or PolicyAssignment()
    taken: set[str] = set()
    folder.mkdir(parents=True, exist_ok=True)
    for comparison in comparisons(analysis):
        figures = unique(make_figures(comparison), taken)
        save(figures, folder, formats)
        parts += [document.header(_title(comparison), verdict(comparison)), document.figures(figures)]
        parts += _tables(comparison, assignment)
    parts.append(document.text("How to read this", METHOD))
    others = [each for each in assignment.commands if each != command]
    if others:
        made = "".join(f"<pre>{html.escape(each)}</pre>" for each in others)
        parts.append(f"<section><h2>The logs were made by</h2>{made}</section>")
    return write_atomic(folder / PAGE, document.page("perdure home: does it stay?", parts, command))


def make_figures(comparison: Comparison) -> list[Figure]:
    """Return all figures of one task and split; those with nothing to show are left out."""
    found: list[Figure | None] = [final_figure(comparison), shape_figure(comparison), kind_figure(comparison)]
    found += [outcome_figure(comparison), stage_figure(comparison)]
    found += [mode_figure(comparison, counting) for counting in reversed(COUNTINGS)]
    found += [release_figure(comparison, measure) for measure in MEASURES]
    stem, heading = comparison.name, _title(comparison)
    return [replace(each, name=slug(stem, each.name), heading=heading) for each in found if each is not None]


def verdict(comparison: Comparison) -> str:
    """Return one sentence: how often the whole task succeeded and stayed so, and what the benchmark counts."""
    lasting, latched = (
        [percent(comparison.final(strategy, counting)["mean"]) for strategy in comparison.strategies]
        for counting in ("stabilizing", "latched")
    )
    stayed = "; ".join(f"{label} {share}" for label, share in zip(comparison.labels, lasting, strict=True))
    return f"Episodes in which every object stayed: {stayed}. The benchmark counts {listed(latched)}."


def _title(comparison: Comparison) -> str:
    return ", ".join(filter(None, (words.task(comparison.task), comparison.split, comparison.world)))


def _tables(comparison: Comparison, assignment: PolicyAssignment) -> list[str]:
    return [
        tables.success_table(comparison),
        tables.paired_table(comparison),
        tables.mode_table(comparison),
        tables.placement_table(comparison),
        tables.release_table(comparison),
        tables.hand_over_table(comparison, assignment),
        tables.assignment_table(comparison, assignment),
    ]
