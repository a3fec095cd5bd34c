"""A comparison or a ranking in words: as text for a terminal, as JSON, and as a page that works offline."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from perdure.disturbances import CALM
from perdure.report import wording
from perdure.report.comparison import (
    BETTER,
    CANNOT_TELL,
    FAILURES,
    MEASURES,
    RUNS,
    START_STATES,
    Ranking,
    Summary,
    bounds,
)
from perdure.report.page import commands, header, page, table
from perdure.runs import write_atomic
from perdure.stats import Interval

PAGE = "comparison.html"
"""Name of the page of a comparison."""
MOST_MORE = 10_000
"""Largest number of further start states or runs that is named."""
NOTE = (
    "Intervals are 95 %. Differences of the deciding condition are intervals by betting, valid although start states "
    "were added until the decision. Others are Student's t below ten start states, else a bootstrap; a share is exact "
    "(Clopper-Pearson). Failures an hour are counted after settling; their bounds are one-sided 95 % each (Garwood)."
)
RUNS_NOTE = (
    "The units are training runs: the episodes of a run are averaged first. Intervals are 95 %, Student's t of a side "
    "and Welch's of a difference (a bootstrap from ten runs on)."
)


# Sentences


def headline(summary: Summary) -> str:
    """Return the answer: "B (geometric) is better than A (ppo): work when calm differs by +0.85 [0.55, 1.06]"."""
    difference = summary.deciding.difference
    size = _cell(difference, summary.by, signed=True)
    counted = _counted(summary)
    differs = f"{MEASURES[summary.by].words} {_where(summary.condition)} differs by {size}"
    if summary.verdict == CANNOT_TELL:
        return (
            f"cannot tell whether B ({summary.b}) is better than A ({summary.a}): {differs} after {counted}; "
            f"{more_words(summary)}"
        )
    return f"B ({summary.b}) is {summary.verdict} than A ({summary.a}): {differs}, decided after {counted}"


def more_words(summary: Summary) -> str:
    """Return how many more start states or runs would decide; "" if it is decided."""
    if summary.verdict != CANNOT_TELL:
        return ""
    a_side = ""
    if summary.unit == RUNS:
        a_side = " a side"
    if summary.more > MOST_MORE:
        return f"more than {MOST_MORE:,} more {summary.unit}s{a_side} would be needed"
    return f"about {wording.count(int(summary.more), f'more {summary.unit}')}{a_side} would decide"


def _counted(summary: Summary) -> str:
    if summary.unit == START_STATES:
        return wording.count(summary.counts[0], summary.unit)
    return f"{summary.counts[0]} and {wording.count(summary.counts[1], summary.unit)}"


def _where(condition: str) -> str:
    return "when calm" if condition == CALM else f"under {condition}"


def ranking_headline(ranking: Ranking) -> str:
    """Return who is best, and whether that was confirmed."""
    first = f"{ranking.winner.name} is first of {len(ranking.policies)}"
    second = ranking.confirmed.a
    if ranking.confirmed.verdict == BETTER:
        return f"{first}; fresh start states confirm that it is better than the second, {second}"
    return f"{first}; fresh start states do not show that it is better than the second, {second}"


def selection(ranking: Ranking) -> str:
    """Return the winner's number where it was selected, and where it was not."""
    fresh = ranking.confirmed
    what = f"{MEASURES[ranking.by].words} {_where(ranking.condition)}".capitalize()
    return (
        f"{what}: {_cell(ranking.winner.value, ranking.by)} "
        f"on the {wording.count(ranking.seeds, 'start state')} that selected it. This number is too high, because the "
        f"best of several is partly lucky. On {wording.count(fresh.counts[0], 'fresh start state')}: "
        f"{_cell(fresh.deciding.b, ranking.by)}."
    )


# Tables


def _number(value: float, measure: str, signed: bool) -> str:
    if not math.isfinite(value):
        return "\u2013"
    if measure == FAILURES:
        text = wording.quantity(value)
    elif measure == "work":
        text = f"{value:.2f}"
    else:
        text = f"{100.0 * value:.0f} %"
    if not signed:
        return text
    return text.replace("-", "\u2212") if value < 0 else f"+{text}"


def _cell(interval: Interval, measure: str, signed: bool = False) -> str:
    """Return "0.85 [0.55, 1.06]", and the estimate alone where there is no interval."""
    found = bounds(interval)
    middle = _number(found["estimate"], measure, signed)
    if not (math.isfinite(found["low"]) and found["low"] < found["high"]):
        return middle
    low, high = (_number(found[name], measure, signed=False).replace("-", "\u2212") for name in ("low", "high"))
    return f"{middle} [{low}, {high}]"


def _headings(summary: Summary) -> tuple[str, ...]:
    return ("condition", "measure", f"A: {summary.a}", f"B: {summary.b}", "B \u2212 A")


def _table_rows(summary: Summary) -> Iterator[tuple[str, ...]]:
    for row in summary.rows:
        words = row.words
        if row == summary.deciding:
            words = f"{words} (decides)"
        condition = {CALM: "calm"}.get(row.condition, row.condition)
        sides = (_cell(row.a, row.measure), _cell(row.b, row.measure))
        yield condition, words, *sides, _cell(row.difference, row.measure, signed=True)


def _ranking_rows(ranking: Ranking) -> Iterator[tuple[str, ...]]:
    for place, each in enumerate(ranking.policies, 1):
        yield str(place), each.name, _cell(each.value, ranking.by), _cell(each.share, "holds")


def _ranking_headings(ranking: Ranking) -> tuple[str, ...]:
    return ("place", "policy", MEASURES[ranking.by].words, "share that holds")


def _aligned(rows: Sequence[Sequence[str]]) -> str:
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return "\n".join("  ".join(map(str.ljust, row, widths)).rstrip() for row in rows)


# Text, JSON, page


def summary_text(summary: Summary) -> str:
    """Return the answer and all numbers for a terminal."""
    notes = [f"  {note}" for note in summary.notes]
    lines = [f"{summary.task}: {headline(summary)}", *notes, "", _aligned([_headings(summary), *_table_rows(summary)])]
    return "\n".join(lines)


def ranking_text(ranking: Ranking) -> str:
    """Return a ranking for a terminal."""
    rows = _aligned([_ranking_headings(ranking), *_ranking_rows(ranking)])
    return "\n".join([f"{ranking.task}: {ranking_headline(ranking)}", f"  {selection(ranking)}", "", rows])


def summary_document(summary: Summary) -> dict[str, Any]:
    """Return a comparison as a document for JSON; unknown numbers are None."""
    rows = []
    for row in summary.rows:
        sides = {"a": row.a, "b": row.b, "difference": row.difference}
        numbers = {name: _known(bounds(interval)) for name, interval in sides.items()}
        rows.append({"condition": row.condition, "measure": row.measure, **numbers, "interval": row.difference.method})
    return {
        "task": summary.task,
        "a": summary.a,
        "b": summary.b,
        "by": summary.by,
        "condition": summary.condition,
        "verdict": summary.verdict,
        **_known({"more": summary.more}),
        "unit": summary.unit,
        "counts": list(summary.counts),
        "measures": rows,
        "notes": list(summary.notes),
    }


def ranking_document(ranking: Ranking) -> dict[str, Any]:
    """Return a ranking as a document for JSON."""
    policies = [
        {"policy": each.name, "value": _known(bounds(each.value)), "share_that_holds": _known(bounds(each.share))}
        for each in ranking.policies
    ]
    return {
        "task": ranking.task,
        "by": ranking.by,
        "condition": ranking.condition,
        "start_states": ranking.seeds,
        "policies": policies,
        "confirmed": summary_document(ranking.confirmed),
    }


def _known(numbers: dict[str, float]) -> dict[str, float | None]:
    return {name: value if math.isfinite(value) else None for name, value in numbers.items()}


def document_text(document: dict[str, Any], **paths: Path) -> str:
    """Return a document as JSON, with the paths of the files that were written."""
    named = {name: str(path.resolve()) for name, path in paths.items()}
    return json.dumps(document | named, indent=2, allow_nan=False)


def write_page(result: Summary | Ranking, out: str | os.PathLike[str], command: str, made: str) -> Path:
    """Write the page of a comparison or a ranking into a folder; return its path.

    Args:
        result: What is shown.
        out: The folder; made if it is missing.
        command: What made it.
        made: What it was made with.
    """
    if isinstance(result, Ranking):
        confirmed = result.confirmed
        numbers = measures_table(confirmed)
        title = f"{len(result.policies)} policies on {result.task}: which is best?"
        first = table("Ranking", _ranking_headings(result), list(_ranking_rows(result)))
        parts = [header(result.task, ranking_headline(result), [selection(result)]), first, numbers]
    else:
        confirmed = result
        numbers = measures_table(confirmed)
        title = f"{result.a} and {result.b} on {result.task}: which is better?"
        parts = [header(result.task, headline(result), list(result.notes)), numbers]
    if confirmed.verdict == CANNOT_TELL:
        parts.append(commands("What to do next", [], f"{more_words(confirmed)} (--most).".capitalize()))
    folder = Path(out)
    folder.mkdir(parents=True, exist_ok=True)
    return write_atomic(folder / PAGE, page(title, parts, command, made))


def measures_table(summary: Summary, note: str = "") -> str:
    """Return the table of all measures, a part of a page; `note` stands under it in place of the usual one."""
    notes = {START_STATES: NOTE, RUNS: RUNS_NOTE}
    return table("Measures", _headings(summary), list(_table_rows(summary)), note or notes[summary.unit])
