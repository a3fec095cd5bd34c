"""``perdure home analyze``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro

from perdure.cli.home.flags import log_files, parse_home
from perdure.cli.parse import check_folder
from perdure.cli.terminal import command_line
from perdure.report.charts import Format


@dataclass(frozen=True)
class HomeAnalyze:
    """Print success per stage, failure causes and placements by kind of object, from logs."""

    logs: tyro.conf.Positional[tuple[Path, ...]]
    """Log files, or folders that hold some, of any tasks and release strategies."""
    out: Path | None = None
    """Folder for report.html, which compares the release strategies, and its figures."""
    formats: tuple[Format, ...] = ("png",)
    """File formats of the figures beside the page."""


def main(args: list[str]) -> None:
    """Run ``perdure home analyze``."""
    flags = parse_home(HomeAnalyze, args, "analyze")
    from perdure.home.evaluate.analysis import analyze
    from perdure.home.evaluate.page import read_all, summary_text, write_page

    paths = log_files(flags.logs)
    if flags.out is not None:
        check_folder(flags.out)
    records, notes = read_all(paths)
    analysis = analyze(records)
    page = None
    if flags.out is not None:
        command = command_line("perdure", "home", "analyze", *args)
        page = write_page(analysis, flags.out, command, notes, flags.formats)
    print(summary_text(analysis, notes))
    if page is not None:
        print(f"\nReport: {page.resolve()}")
