"""``perdure home day``: errands in homes that are never reset."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from perdure.cli.home_options import Fallback, PlannerName, RunOptions
from perdure.cli.parse import Cores, On, check_folder
from perdure.errors import PerdureError
from perdure.report.charts import Format

if TYPE_CHECKING:
    from perdure.home.evaluate.day import DayProtocol


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
    film: int | None = None,
    film_errands: tuple[int, ...] = (1, 10),
    command: str = "",
) -> None:
    """Run errand after errand in homes that are never reset: do they stay in order? Interrupt it any time.

    After each errand new goals are drawn for objects where they are. Table and report lie in the folder of the run.

    Args:
        out: Folder of the runs.
        formats: File formats of the figures beside the page.
        film: Number of a home; also film errands of it side by side, beside the page.
        film_errands: Numbers of these errands, from 1. The day of the home is run again up to the last of them.
        command: The command line, stored with the table.
    """
    from perdure.home.evaluate.day import DayProtocol, run_days
    from perdure.home.evaluate.day_page import make_views, summary, write_page
    from perdure.home.evaluate.day_table import read_days
    from perdure.runs.progress import show_progress

    check_folder(out)
    if not days.errands:
        raise PerdureError("--errands must name at least one task")
    if film is not None and not 0 <= film < days.homes:
        raise PerdureError(f"--film must be one of the homes 0 to {days.homes - 1}, not {film}")
    protocol = DayProtocol(days.errands, days.hours, days.protocol(days.errands[0], days.homes))
    with show_progress(f"day of {', '.join(days.errands)}", "hours") as observe:
        path = run_days(protocol, out, cores=cores, on=on, command=command, observe=observe)
    table, _ = read_days(path)
    page = write_page(table, path.parent, command, formats)
    print("\n\n".join(summary(view) for view in make_views(table)))
    print(f"\nReport: {page.resolve()}\nTable: {path}")
    if film is not None:
        print(f"Film: {_film(protocol, film, film_errands, path.parent)}")


def _film(protocol: DayProtocol, home: int, numbers: tuple[int, ...], folder: Path) -> Path:
    """Film errands of a home side by side, with the policies of training seed 0, and return the film."""
    from perdure.home.evaluate.day import find_errands
    from perdure.home.film import Agent, film_errands

    path = folder / f"home-{home}-errands-{'-'.join(map(str, numbers))}.mp4"
    errands = find_errands(protocol, home, numbers)
    agents = {task: Agent(protocol.protocol_of(task)) for task in protocol.errands}
    film_errands(errands, agents, path)
    return path
