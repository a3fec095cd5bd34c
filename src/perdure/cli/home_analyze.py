"""``perdure home analyze``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro

from perdure.cli.parse import check_folder, log_files, parse
from perdure.cli.terminal import command_line
from perdure.report.render import Format


@dataclass(frozen=True)
class HomeAnalyze:
    """Say what became of executed episodes: success per stage, failure modes, placements by kind of object."""

    logs: tyro.conf.Positional[tuple[Path, ...]]
    """Files of logs, or folders that hold some; of several tasks and placing arms if you like."""
    out: Path | None = None
    """Folder for report.html, which sets the arms side by side, and its figures."""
    formats: tuple[Format, ...] = ("png",)
    """What each figure is written as, beside the page."""


def main(args: list[str]) -> None:
    """``perdure home analyze``."""
    flags = parse(HomeAnalyze, args, "home analyze")
    from perdure.home.evaluate.outcomes import analyze
    from perdure.home.evaluate.page import read_cast, write_page

    paths = log_files(flags.logs)
    if flags.out is not None:
        check_folder(flags.out)
    records, cast = read_cast(paths)
    analysis = analyze(records)
    page = None
    if flags.out is not None:
        page = write_page(analysis, flags.out, command_line("perdure", "home", "analyze", *args), cast, flags.formats)
    print(analysis.summary())
    if page is not None:
        print(f"\nReport: {page.resolve()}")
