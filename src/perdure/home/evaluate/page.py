"""The page of the home benchmark: figures and tables of every task, and each figure as a picture file beside it."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from perdure.home.evaluate.analysis import GROUP, Analysis, group_of
from perdure.home.evaluate.comparison import make_tables, make_views, summary, verdict
from perdure.home.evaluate.figures import make_figures
from perdure.home.evaluate.files import HAND_OVERS, POLICIES, read_log_files, read_note
from perdure.home.evaluate.log import EpisodeLog
from perdure.report import page as document
from perdure.report.charts import Format, save, unique
from perdure.runs import write_atomic
from perdure.schema import printable

if TYPE_CHECKING:
    import polars as pl

PAGE = "report.html"
METHOD = """A task plan runs skills one after the other, from the same episodes and start poses under every release
strategy. <em>Latched</em> counts as the benchmark does: a stage that was reached stays reached.
<em>Goal-stabilizing</em> counts as the thesis does: from the end of its place to the end of the episode and of the
settling time after it, the object is in its goal and out of the hand at every step. Every number comes from the logs
alone; nothing is simulated for this page."""


@dataclass(frozen=True)
class LogNotes:
    """What log files note beside their episodes; rows begin with the values of `GROUP`."""

    policies: tuple[tuple[str, ...], ...] = ()
    """Skill and name of a policy; several where there are several training seeds."""
    commands: tuple[str, ...] = ()
    hand_overs: Mapping[tuple[str, ...], int] = field(default_factory=dict)
    """Outcome of a hand-over to its count, see `HandOver.outcomes`."""

    @property
    def tables(self) -> dict[str, pl.DataFrame]:
        """The tables `policies` and `hand_overs` of a comparison."""
        import polars as pl

        text = dict.fromkeys((*GROUP, "skill", "policy"), pl.String)
        counted = {**dict.fromkeys((*GROUP, "outcome"), pl.String), "count": pl.Int64}
        counts = [(*key, count) for key, count in self.hand_overs.items()]
        return {
            "policies": pl.DataFrame(self.policies, schema=text, orient="row"),
            "hand_overs": pl.DataFrame(counts, schema=counted, orient="row"),
        }


def read_all(
    paths: Sequence[str | os.PathLike[str]], names: Mapping[Path, str] | None = None
) -> tuple[list[EpisodeLog], LogNotes]:
    """Return the logs of files and their notes; names as for `read_log_files`. Other simulators note no policies.

    Raises:
        PerdureError: A file holds no logs, see `read_log_file`, a note is no JSON object, or two files hold the same
            episode of a strategy and its seeds, such as those of a trial run and of the whole run.
    """
    records: list[EpisodeLog] = []
    policies: dict[tuple[str, ...], None] = {}
    commands: dict[str, None] = {}
    hand_overs: Counter[tuple[str, ...]] = Counter()
    for read, notes, _ in read_log_files(paths, names):
        records += read
        if notes.get("command"):
            commands[printable(notes["command"], lines=True)] = None
        acting = read_note(notes, "policies", POLICIES)
        counts = read_note(notes, "hand_overs", HAND_OVERS)
        for group in dict.fromkeys(group_of(record) for record in read):
            policies |= {(*group, printable(skill), printable(name)): None for skill, name in acting.items()}
            hand_overs.update({(*group, printable(outcome)): count for outcome, count in counts.items()})
    return records, LogNotes(tuple(policies), tuple(commands), hand_overs)


def summary_text(analysis: Analysis, notes: LogNotes | None = None) -> str:
    """Return the main tables of every task and split as text for a terminal."""
    return "\n\n".join(map(summary, make_views({**vars(analysis), **(notes or LogNotes()).tables})))


def write_page(
    analysis: Analysis,
    out: str | os.PathLike[str],
    command: str,
    notes: LogNotes | None = None,
    formats: Sequence[Format] = ("png",),
) -> Path:
    """Write `report.html`, which needs no network, and each figure as a file beside it.

    Args:
        analysis: From `analyze`; several tasks, splits and strategies may be in it.
        out: A folder; made if it is missing.
        command: What made the page; shown so that a reader can repeat it.
        notes: From `read_all`: the policies; the page says "not recorded" without it.
        formats: Of the files: "png", "svg", "pdf"; () writes the page alone.

    Returns:
        The page.

    Raises:
        PerdureError: An unknown format.
        OSError: The folder cannot be written.
    """
    folder = Path(out)
    notes = notes or LogNotes()
    parts: list[str] = []
    taken: set[str] = set()
    folder.mkdir(parents=True, exist_ok=True)
    for view in make_views({**vars(analysis), **notes.tables}):
        figures = unique(make_figures(view), taken)
        save(figures, folder, formats)
        parts += [document.header(view.title, verdict(view)), document.figures(figures)]
        parts += [document.table(each.title, each.headings, each.rows, each.note) for each in make_tables(view)]
    parts.append(document.text("How to read this", METHOD))
    if others := [each for each in notes.commands if each != command]:
        parts.append(document.commands("The logs were made by", others))
    return write_atomic(folder / PAGE, document.page("perdure home: does it stay?", parts, command))
