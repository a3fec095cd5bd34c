"""Figures of failures: outcomes of episodes (figures 2-1, 2-3), and first unmet stage x failure cause."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from perdure.home.evaluate.outcomes import FAILURE_CAUSES, Counting
from perdure.home.evaluate.page import words
from perdure.home.evaluate.page.comparison import Comparison, listed
from perdure.report import theme, wording
from perdure.report.axes import Axis
from perdure.report.render import Figure
from perdure.report.rows import Bars, bar_chart

_COLUMNS = ("outcome", "count", "of_all", "of_failed")


def outcome_figure(comparison: Comparison) -> Figure:
    """Return the figure of outcomes: a row for each outcome, a bar for each strategy."""
    names = [
        name
        for number, name in enumerate(comparison.outcomes[comparison.strategies[0]]["outcome"])
        if any(comparison.outcomes[strategy]["count"][number] for strategy in comparison.strategies)
    ]
    bars = []
    for strategy, label, style in zip(comparison.strategies, comparison.labels, comparison.styles, strict=True):
        found = {name: shares for name, *shares in comparison.outcomes[strategy].select(*_COLUMNS).iter_rows()}
        rows = [(names.index(name), *found[name]) for name in names]
        total = len(comparison.episodes[strategy])
        bars.append(_shares(label, style, rows, total))
    return Figure(
        name="outcomes",
        title="What became of the episodes",
        chart=bar_chart(
            [words.outcome(name) for name in names], bars, Axis("share of episodes", percent=True), theme.WIDE
        ),
        note="Counted as success: by the benchmark. Did not stay: the first placement that failed or did not last.",
        wide=True,
    )


def _shares(label: str, style: theme.Style, rows: Sequence[tuple[int, int, float, float | None]], total: int) -> Bars:
    """Return bars of shares with their counts, from (row, count, share of all, share of the failed)."""
    texts = [
        f"{count} of {total} ({wording.share(of_all)})"
        + ("" if of_failed is None or not count else f", {wording.share(of_failed)} of the failed")
        for _, count, of_all, of_failed in rows
    ]
    return Bars(label, [row for row, *_ in rows], np.array([of_all for _, _, of_all, _ in rows]), texts, style)


def mode_figure(comparison: Comparison, counting: Counting) -> Figure | None:
    """Return the figure of failures by stage and cause, a bar for each strategy; None when nothing failed."""
    labels = mode_labels(comparison, counting)
    if not labels:
        return None
    bars = []
    for strategy, label, style in zip(comparison.strategies, comparison.labels, comparison.styles, strict=True):
        counts = mode_counts(comparison, counting, strategy)
        rows = [(row, *counts[each]) for row, each in enumerate(labels) if each in counts]
        bars.append(_shares(label, style, rows, len(comparison.episodes[strategy])))
    task = comparison.home_task
    way = "latched" if counting == "latched" else "goal-stabilizing"
    names = [f"{words.stage(task.stage(stage), unmet=True)}: {cause}" for stage, cause in labels]
    return Figure(
        name=f"modes-{counting}",
        title=f"Why episodes failed, {way} counting",
        chart=bar_chart(names, bars, Axis("share of all episodes", percent=True), theme.WIDE),
        note="One cause for each failed episode: what went wrong in the first stage that failed or did not last."
        + _force_note(comparison),
        wide=True,
    )


def _force_note(comparison: Comparison) -> str:
    without = [
        label
        for strategy, label in zip(comparison.strategies, comparison.labels, strict=True)
        if not comparison.episodes[strategy]["force"].is_finite().any()
    ]
    if not without:
        return ""
    return f" The logs of {listed(without)} hold no contact forces, so none of their causes is a collision."


def mode_labels(comparison: Comparison, counting: Counting) -> list[tuple[str, str]]:
    """Return every (stage, cause) that any strategy has, in the task's order."""
    stages = [stage.name for stage in comparison.home_task.stages]
    found = {label for strategy in comparison.strategies for label in mode_counts(comparison, counting, strategy)}
    return sorted(found, key=lambda label: (stages.index(label[0]), FAILURE_CAUSES.index(label[1])))


def mode_counts(
    comparison: Comparison, counting: Counting, strategy: str
) -> dict[tuple[str, str], tuple[int, float, float]]:
    """Return count, share of all and share of failed episodes for each (stage, failure cause) of a strategy."""
    table = comparison.modes[strategy].filter(counting=counting)
    rows = table.select("stage", "cause", "count", "of_all", "of_failed").iter_rows()
    return {(stage, cause): (count, a, b) for stage, cause, count, a, b in rows}
