"""``perdure report``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import tyro

from perdure.cli.parse import parse
from perdure.report.charts import Format


@dataclass(frozen=True)
class ReportFlags:
    """Make report.html and its figures from a table that `perdure extrapolate` wrote."""

    table: tyro.conf.Positional[Path]
    """The table lanes.parquet, or the folder that holds it."""
    out: Path | None = None
    """Folder to write into; the table's own by default."""
    formats: tuple[Format, ...] = ("png",)
    """File formats of the figures beside the page."""


def main(args: list[str]) -> None:
    """``perdure report``."""
    flags = parse(ReportFlags, args, "report")
    table = find_table(flags.table)
    write_and_show(table, flags.out or table.parent, flags.formats)


def find_table(path: Path) -> Path:
    """Return the table that a path means: in a folder its lanes.parquet."""
    if not path.is_dir():
        return path
    from perdure.evaluate.table import TABLE

    return path / TABLE


def write_and_show(table: Path, out: Path, formats: Sequence[Format] = ("png",)) -> None:
    """Write the report of a table into ``out``; print the summary and the path of the report."""
    from perdure.report import estimate_table, read_lanes, summary_text, write_report

    lanes, notes = read_lanes(table)
    estimates = estimate_table(lanes)
    del lanes  # of a large table
    print(summary_text(estimates))
    print(f"\nReport: {write_report(estimates, out, notes.get('command', ''), formats).resolve()}")
