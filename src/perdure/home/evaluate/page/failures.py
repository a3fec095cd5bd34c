"""Charts of failure: what became of the episodes (figures 2-1, 2-3), and first unmet stage x mechanism."""

from __future__ import annotations

import numpy as np

from perdure.home.evaluate.outcomes import MECHANISMS, Counting
from perdure.home.evaluate.page.comparison import Comparison
from perdure.report import wording
from perdure.report.charts import Axis, Bars, Chart
from perdure.report.palette import FADED, Colour, category

_COLOURS = {"success": category(2), "success that did not last": category(4), "other": FADED}
_PLACES = tuple(category(number) for number in (1, 3, 6, 0, 5))


def outcome_chart(comparison: Comparison) -> Chart:
    """Two rows for each arm: all its episodes, and the failed ones alone."""
    rows, names = [], list(comparison.outcomes[comparison.arms[0]]["outcome"])
    for arm in comparison.arms:
        table = comparison.outcomes[arm]
        failed = table.filter(table["of_failed"].is_not_null())["count"].sum()
        rows += [f"{arm}: all {wording.count(len(comparison.episodes[arm]), 'episode')}"]
        rows += [f"{arm}: the {failed} failed" if failed else f"{arm}: none failed"]
    bars = tuple(
        _outcome_bars(comparison, number, name)
        for number, name in enumerate(names)
        if any(comparison.outcomes[arm]["count"][number] for arm in comparison.arms)
    )
    return Chart(
        name="outcomes",
        title="What became of the episodes",
        x=Axis("share", percent=True, low=0.0, high=1.0),
        y=Axis("", rows=tuple(rows)),
        series=(),
        bars=bars,
        note="place_k: failed, and the first stage that does not count is that placement (it did not stay). "
        "A success that did not last is one that the benchmark counts.",
        wide=True,
    )


def _outcome_bars(comparison: Comparison, number: int, name: str) -> Bars:
    places, start, end, texts = [], [], [], []
    for k, arm in enumerate(comparison.arms):
        table = comparison.outcomes[arm]
        for row, column in ((2 * k, "of_all"), (2 * k + 1, "of_failed")):
            shares = table[column].fill_null(0.0).to_list()
            if shares[number] > 0.0:
                places.append(float(row))
                start.append(sum(shares[:number]))
                end.append(sum(shares[: number + 1]))
                texts.append(f"{table['count'][number]} ({wording.share(shares[number])})")
    return Bars(name, np.array(places), np.array(start), np.array(end), _colour(name), 0.72, tuple(texts), inside=True)


def _colour(outcome: str) -> Colour:
    if outcome in _COLOURS:
        return _COLOURS[outcome]
    return _PLACES[int(outcome.partition("_")[2]) % len(_PLACES)]


def mode_chart(comparison: Comparison, counting: Counting) -> Chart | None:
    """First unmet stage and mechanism of every failed episode, a bar for each arm; None when nothing failed.

    Args:
        comparison: The arms.
        counting: By which way of counting they failed.
    """
    labels = mode_labels(comparison, counting)
    if not labels:
        return None
    lines = len(comparison.arms)
    bars = []
    for k, (arm, colour) in enumerate(zip(comparison.arms, comparison.colours, strict=True)):
        shown = [each for each in mode_counts(comparison, counting, arm).items() if each[0] in labels]
        rows = [labels.index(label) + (k + 0.5) / lines * 0.84 - 0.42 for label, _ in shown]
        shares = np.array([of_all for _, (_, of_all, _) in shown])
        texts = tuple(
            f"{count} ({wording.share(of_all)} of all, {wording.share(of_failed)} of failed)"
            for _, (count, of_all, of_failed) in shown
        )
        bars.append(Bars(arm, np.array(rows), 0.0 * shares, shares, colour, 0.76 / lines, texts))
    most = max(float(each.end.max(initial=0.0)) for each in bars)
    way = "latched" if counting == "latched" else "goal-stabilizing"
    return Chart(
        name=f"modes-{counting}",
        title=f"Why episodes failed, {way} counting",
        x=Axis("share of all episodes", percent=True, low=0.0, high=1.6 * most),
        y=Axis("", rows=tuple(f"{stage}: {mechanism}" for stage, mechanism in labels)),
        series=(),
        bars=tuple(bars),
        row_lines=lines,
        note="One label for each failed episode: the first unmet stage and what went wrong there.",
        wide=True,
    )


def mode_labels(comparison: Comparison, counting: Counting) -> list[tuple[str, str]]:
    """Every (stage, mechanism) that any arm has, in the task's order."""
    stages = [stage.name for stage in comparison.home_task.stages]
    found = {label for arm in comparison.arms for label in mode_counts(comparison, counting, arm)}
    return sorted(found, key=lambda label: (stages.index(label[0]), MECHANISMS.index(label[1])))


def mode_counts(
    comparison: Comparison, counting: Counting, arm: str
) -> dict[tuple[str, str], tuple[int, float, float]]:
    """For each (stage, mechanism) of an arm: the count, its share of all episodes, and of the failed ones."""
    table = comparison.modes[arm].filter(counting=counting)
    rows = table.select("stage", "mechanism", "count", "of_all", "of_failed").iter_rows()
    return {(stage, mechanism): (count, a, b) for stage, mechanism, count, a, b in rows}
