"""``perdure home day``: errands in homes that are never reset."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from perdure.cli.home_options import Fallback, PlannerName, RunOptions
from perdure.cli.parse import Cores, On, check_folder
from perdure.errors import PerdureError
from perdure.report.charts import Format


@dataclass(frozen=True)
class Days(RunOptions):
    """What is run in which homes."""

    planner: PlannerName = "closed"
    fallback: Fallback = "oracle"
    errands: tuple[str, ...] = ("tidy_house",)
    """Tasks of `perdure home list`, which alternate in this order."""
    hours: float = 1.0
    """Simulated hours of each home; its last errand begins before they are up."""
    homes: int = 20
    """Number of homes: the first episodes of each apartment of the split, then the second ones."""


def day(
    days: Annotated[Days, tyro.conf.OmitArgPrefixes] = Days(),
    cores: Cores = None,
    on: On = "local",
    out: Path = Path("home-days"),
    formats: tuple[Format, ...] = ("png",),
    command: str = "",
) -> None:
    """Run errand after errand in homes that are never reset: do they stay in order? Interrupt it any time.

    After each errand new goals are drawn for objects where they are. Table and report lie in the folder of the run.

    Args:
        out: Folder of the runs.
        formats: File formats of the figures beside the page.
        command: The command line, stored with the table.
    """
    from perdure.home.evaluate.day import DayProtocol, run_days
    from perdure.home.evaluate.day_page import make_views, summary, write_page
    from perdure.home.evaluate.day_table import read_days
    from perdure.runs.progress import show_progress

    check_folder(out)
    if not days.errands:
        raise PerdureError("--errands must name at least one task")
    protocol = DayProtocol(days.errands, days.hours, days.protocol(days.errands[0], days.homes))
    with show_progress(f"day of {', '.join(days.errands)}", "hours") as observe:
        path = run_days(protocol, out, cores=cores, on=on, command=command, observe=observe)
    table, _ = read_days(path)
    page = write_page(table, path.parent, command, formats)
    print("\n\n".join(summary(view) for view in make_views(table)))
    print(f"\nReport: {page.resolve()}\nTable: {path}")
