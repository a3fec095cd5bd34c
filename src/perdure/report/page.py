"""Pages: `page.html` filled with figures and tables, and the report of a table with an image file of each figure.

`header`, `figures`, `table`, `text` and `commands` return escaped parts of a page; `page` makes one file of them, which
works offline.
"""

from __future__ import annotations

import base64
import hashlib
import os
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cache
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import polars as pl

from perdure.disturbances import CALM
from perdure.report import wording
from perdure.report.charts import DARK, Figure, Format, javascript, save, script_json, unique
from perdure.report.estimates import (
    SEED,
    Estimate,
    Estimates,
    best_clocks,
    endured,
    estimate_table,
    headline,
)
from perdure.report.figures import make_figures
from perdure.report.groups import success_cells
from perdure.report.lead import Step, VerdictRow, next_steps, one_line, verdict_row
from perdure.report.outcomes import outcomes
from perdure.report.schema import TABLE, early_stop, read_episodes
from perdure.runs import write_atomic
from perdure.schema import printable
from perdure.stats import Interval, mean_interval

if TYPE_CHECKING:
    from jinja2 import Template

# Parts of a page


@cache
def _template() -> Template:
    from jinja2 import Environment, FileSystemLoader
    from markupsafe import Markup

    environment = Environment(autoescape=True, loader=FileSystemLoader(Path(__file__).parent))
    environment.filters["json"] = lambda value: Markup(script_json(value))
    environment.globals["outcomes"] = outcomes
    return environment.get_template("page.html")


def _part(name: str, *values: Any) -> str:
    found: str = getattr(_template().module, name)(*values)
    return found


def header(
    task: str,
    sentence: str,
    points: Sequence[str] = (),
    verdicts: Sequence[VerdictRow] = (),
    following: Sequence[Step] = (),
) -> str:
    """Return a task's name over the sentence that sums it up, and points below it, all plain text.

    `verdicts`: each a word in its color, and details. `following`: what to do next; commands get a button that copies.
    """
    return _part("header", task, sentence, points, verdicts, following)


def figures(drawn: Sequence[Figure]) -> str:
    """Return figures with their titles and notes, two beside each other where the page is wide enough.

    The last of an odd number is as wide as the page.
    """
    shown = list(drawn)
    narrow = [place for place, each in enumerate(shown) if not each.wide]
    if len(narrow) % 2:
        shown[narrow[-1]] = replace(shown[narrow[-1]], wide=True)
    return _part("figures", shown)


def table(
    title: str, headings: Sequence[str], rows: Sequence[Sequence[str]], note: str = "", folded: bool = False
) -> str:
    """Return a table of plain text under its title, over its note; `folded` shows the title until it is opened."""
    return _part("table", title, headings, rows, note, folded)


def picture(title: str, png: bytes) -> str:
    """Return a picture under its title."""
    return _part("picture", title, base64.b64encode(png).decode())


def text(title: str, markup: str) -> str:
    """Return a paragraph with its title; `markup` is HTML."""
    from markupsafe import Markup

    return _part("text", title, Markup(markup))


def commands(title: str, lines: Sequence[str], note: str = "") -> str:
    """Return commands with their title, free of control characters, each with a button that copies it."""
    return _part("commands", title, [printable(line, lines=True) for line in lines], note)


def page(title: str, parts: Sequence[str], command: str, made: str = "") -> str:
    """Return the whole page of parts that the functions above returned.

    It ends with the command ("": not recorded) and with what it was made with, such as versions and date.
    """
    scripts = [each.replace("</script", "<\\/script") for each in (javascript(), str(_part("script")))]
    digests = [base64.b64encode(hashlib.sha256(each.encode()).digest()).decode() for each in scripts]
    # Vega sets style attributes; they can request nothing that default-src and img-src do not allow.
    allowed = " ".join(f"'sha256-{digest}'" for digest in digests)
    policy = (
        f"default-src 'none'; script-src {allowed}; "
        "style-src 'unsafe-inline'; img-src data:; base-uri 'none'; form-action 'none'"
    )
    last = commands("Command", [command or "not recorded"], printable(made))
    found = _template().render(title=title, parts=[*parts, last], policy=policy, dark=DARK, scripts=scripts)
    return found.lstrip()


# The report of a table

PAGE = "report.html"
STILLS = "failure.png"
MOST_VERDICTS = 12
"""Most policies and clocks for which the text gives the evidence."""
MOST_NAMED = 3
"""Most policies in the title of a page."""
MOST_SHOWN = 40
"""Most episodes in a table that is open at first."""
MOST_EPISODES = 1000
"""Most episodes in a table."""
Table = pl.DataFrame | str | os.PathLike[str]


def write_report(
    table: Table | Estimates,
    out: str | os.PathLike[str],
    command: str,
    formats: Sequence[Format] = ("png",),
    notes: Mapping[str, str] | None = None,
    stills: Path | None = None,
    files: Mapping[str, str] | None = None,
) -> Path:
    """Write the page, and each figure as a file beside it; return the page's path.

    Args:
        table: An extrapolation table, its file, or what `estimate_table` made of it.
        out: A folder; made if it is missing.
        command: What made the table; shown so that a reader can repeat it.
        formats: Of the files: "png", "svg", "pdf"; () writes the page alone.
        notes: Metadata of the table's file: `versions`, `evaluated` (the day) and an early stop are shown.
        stills: A PNG file of one failure; it need not exist.
        files: SHA-256 of policy files to the names by which commands find them.

    Raises:
        PerdureError: The table does not fit the schema, or a format is unknown.
        OSError: The folder cannot be written.
    """
    by_task = _estimates(table)
    folder = Path(out)
    stopped = early_stop(notes or {})
    parts = list[str]()
    taken = set[str]()
    folder.mkdir(parents=True, exist_ok=True)
    javascript()  # bundled before figures are drawn: the other way round takes 60 MB more
    for task, estimates in by_task.items():
        top, others = (unique(drawn, taken) for drawn in make_figures(estimates))
        save([*top, *others], folder, formats)
        sentence = one_line([item.verdict for item in estimates])
        verdicts = [verdict_row(item.verdict) for item in estimates[:MOST_VERDICTS]]
        points = list(_beside_verdicts(estimates))
        if stopped is not None:
            points.append(f"The evaluation {stopped}.")
        after = next_steps(estimates, folder, command, notes, files or {})
        parts.append(header(task, sentence, points, verdicts, after))
        shown = [picture("A failure", stills.read_bytes())] if stills is not None and stills.is_file() else []
        parts += [figures(top), *shown, *_tables(estimates), figures(others)]
    made = ". ".join(f"{what} {notes[name]}" for name, what in MADE.items() if notes and notes.get(name))
    return write_atomic(folder / PAGE, page(_title(by_task), [*parts, _part("words")], command, made))


MADE = {"evaluated": "Evaluated on", "versions": "With"}
"""Name of a note of a table's file to the words before it."""


def _title(by_task: Estimates) -> str:
    """Return the title of the page: policies and tasks."""
    parts = []
    for task, estimates in by_task.items():
        names = list(dict.fromkeys(item.group.policy_and_clock for item in estimates))
        more = f" and {len(names) - MOST_NAMED} more" if len(names) > MOST_NAMED else ""
        parts.append(f"{'; '.join(names[:MOST_NAMED])}{more} on {task}")
    return f"{', '.join(parts)}: does it hold?"


def summary_text(table: Table | Estimates) -> str:
    """Return the verdicts and the table of numbers as plain text, for a terminal; `table` as in `write_report`."""
    parts = []
    for estimates in _estimates(table).values():
        rows = _rows(estimates)
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        lines = ["  ".join(map(str.ljust, row, widths)).rstrip() for row in rows]
        points = [item.verdict.sentence for item in estimates[:MOST_VERDICTS]]
        points = [f"  {point}" for point in (*points, *_beside_verdicts(estimates))]
        parts.append("\n".join([headline([item.verdict for item in estimates]), *points, "", *lines]))
    return "\n\n".join(parts)


def _estimates(table: Table | Estimates) -> Estimates:
    if isinstance(table, dict):
        return table
    return estimate_table(table if isinstance(table, pl.DataFrame) else read_episodes(table)[0])


def _beside_verdicts(estimates: Sequence[Estimate]) -> Iterator[str]:
    """Yield the sentences under the verdicts: how many are left out, and the best clock of each policy."""
    if len(estimates) > MOST_VERDICTS:
        yield f"{len(estimates) - MOST_VERDICTS} more policies and clocks are in the table."
    yield from endured(estimates)
    yield from best_clocks(estimates, np.random.default_rng(SEED))


def _tables(estimates: Sequence[Estimate]) -> Iterator[str]:
    over = " or ".join(sorted({_over(item.returns) for item in estimates}))
    missing = {(item.group.disturbance, what) for item in estimates for what in item.group["not_applied"] if what}
    left_out = "".join(
        f" Not applied{'' if label == CALM else f' under {label}'}: {what}." for label, what in sorted(missing)
    )
    headings, *cells = _rows(estimates)
    yield table("Policies, clocks and conditions", headings, cells, f"Intervals over {over}.{left_out}")
    episodes = sum(item.group.episodes for item in estimates)
    rows = [row for item in estimates for row in _episode_rows(item)][:MOST_EPISODES]
    left = f"The first {len(rows):,} of {episodes:,}; episodes.parquet has all." if len(rows) < episodes else ""
    yield table(wording.count(episodes, "episode").capitalize(), _EPISODE, rows, left, episodes > MOST_SHOWN)
    if runs := list(_run_rows(estimates)):
        note = (
            "Training runs of one method often differ more than methods do. A run that you choose here was chosen on "
            "these start states: confirm it on others (--first-eval-seed)."
        )
        headings = ("policy", "clock", "training seed", "episodes", "return", "verdict", END_SCORE, "episodes that")
        yield table("Training runs", headings, runs, note)
    if clocks := list(_clock_rows(estimates, np.random.default_rng(SEED))):
        note = "Differences of the final return from the same start states, averaged within training runs."
        columns = ("policy", "clock", "against", "difference of the return", "95 % interval", "better in")
        yield table("Clocks compared", (*columns, "intervals over"), clocks, note)


def _mean(values: np.ndarray[Any, Any]) -> str:
    """Return the mean of the known values: a share of flags, or a quantity."""
    if values.dtype == np.bool_:
        return wording.share(float(values.mean()))
    return wording.quantity(float(np.nanmean(values)) if np.isfinite(values).any() else np.nan)


def _bounds(interval: Interval) -> str:
    low, high = interval.last()
    return "\u2013" if np.isnan(low) else f"{wording.quantity(low)} to {wording.quantity(high)}"


def _over(interval: Interval) -> str:
    return f"{interval.label} ({interval.method}, {wording.count(interval.count, 'unit')})"


def _outcomes(verdicts: Sequence[str]) -> str:
    return ", ".join(f"{verdict} {number}" for verdict, number in Counter(verdicts).most_common())


END_SCORE = "end vs training"
UNKNOWN = "\u2013"
"""Of a cell whose value is not known."""


def _column_cell(name: str) -> Callable[[Estimate], str]:
    """Return the cell that shows the mean of a column of the table."""
    return lambda item: _mean(item.group[name])


_CELLS: dict[str, Callable[[Estimate], str]] = {
    "policy": lambda item: item.group.line,
    "clock": lambda item: item.group.clock,
    "episodes": lambda item: f"{item.group.episodes:,}",
    "steps": lambda item: wording.whole(item.group.test_horizon),
    "return": lambda item: wording.quantity(item.final_return),
    "95 % interval": lambda item: _bounds(item.returns),
    "verdict": lambda item: item.verdict.word,
    END_SCORE: lambda item: wording.quantity(float(item.final_score.estimate)),
    "running": lambda item: _mean(item.group.alive[:, -1]),
    **{column.heading: _column_cell(name) for name, column in TABLE.items() if column.heading},
    "training vs published": lambda item: _mean(item.group["training_score"]),
    "half failed by": lambda item: (
        wording.whole(steps) if np.isfinite(steps := item.group.half_failed_by) else "\u2013"
    ),
    "episodes that": lambda item: _outcomes(item.group.verdicts),
}
"""Heading to the cell of a policy and clock."""


def _rows(estimates: Sequence[Estimate]) -> list[tuple[str, ...]]:
    """Return the headings, and a row for each policy and clock; columns in which nothing is known are left out."""
    found = [{name: cell(item) for name, cell in _CELLS.items()} | success_cells(item.group) for item in estimates]
    names = dict.fromkeys(name for each in found for name in each)
    shown = [name for name in names if any(each.get(name, UNKNOWN) != UNKNOWN for each in found)]
    return [tuple(shown), *(tuple(each.get(name, UNKNOWN) for name in shown) for each in found)]


_EPISODE = (
    *("policy", "clock", "training seed", "start state", "outcome", "failed at step", "ended at step", "end", "return"),
)


def _episode_rows(item: Estimate) -> Iterator[tuple[str, ...]]:
    """Yield one row for each episode."""
    group = item.group
    columns = [group[name] for name in ("train_seed", "eval_seed", "failed_step", "end_step", "end_reason")]
    rows = zip(*columns, group.verdicts, group.failed, group.returns[:, -1], strict=True)
    for run, start, failure, end, reason, word, failed, earned in rows:
        cells = (str(run), str(start), word, f"{failure:,}" if failed else "\u2013", f"{end:,}", reason)
        yield group.line, group.clock, *cells, wording.quantity(earned)


def _run_rows(estimates: Sequence[Estimate]) -> Iterator[tuple[str, ...]]:
    """Yield one row for each training run of the groups that have several."""
    for item in estimates:
        group = item.group
        for seed, label in sorted(item.verdict.by_training_seed.items()):
            mine = group["train_seed"] == seed
            verdicts = [verdict for verdict, chosen in zip(group.verdicts, mine, strict=True) if chosen]
            mean = wording.quantity(float(group.returns[mine, -1].mean()))
            cells = (str(seed), f"{len(verdicts):,}", mean, label, _mean(group.final_score[mine]), _outcomes(verdicts))
            yield group.line, group.clock, *cells


def _clock_rows(estimates: Sequence[Estimate], rng: np.random.Generator) -> Iterator[tuple[str, ...]]:
    """Compare each clock with the first one of the same line, on the policies and start states that both have."""
    for line, items in groupby(estimates, key=lambda item: item.group.line):
        first, *others = [item.group for item in items]
        for group in others:
            mine, its = group.paired(first)
            if mine:
                difference = group.returns[mine, -1] - first.returns[its, -1]
                found = mean_interval(difference, group.runs[mine], rng)
                better = f"{int((difference > 0).sum())} of {wording.count(len(mine), 'episode')}"
                middle = wording.quantity(float(found.estimate))
                yield line, group.clock, first.clock, middle, _bounds(found), better, _over(found)
