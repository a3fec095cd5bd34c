"""A progress bar for evaluations."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

if TYPE_CHECKING:
    from perdure.extrapolate.run import Watcher


@contextmanager
def progress_bar() -> Iterator[Watcher]:
    """Gives a watcher that draws the bar for as long as the block lasts."""
    columns = (TextColumn("lane steps"), BarColumn(), TextColumn("{task.percentage:>3.0f} %"), TimeRemainingColumn())
    console = Console(stderr=True)
    with Progress(*columns, console=console, disable=not console.is_terminal) as bar:
        task = bar.add_task("lanes", total=None)

        def watch(made: int, total: int) -> None:
            bar.update(task, completed=made, total=total)

        yield watch
