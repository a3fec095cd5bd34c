"""A progress bar for training: steps a second, return, time left."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

if TYPE_CHECKING:
    from rich.console import Console

    from perdure.ppo.runs import Report, Watcher


@contextmanager
def progress_bar(title: str, console: Console) -> Iterator[Watcher]:
    """Gives a watcher that draws the bar for as long as the block lasts."""
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f} %  {task.fields[rate]}  return {task.fields[mean]}"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console, disable=not console.is_terminal) as bar:
        task = bar.add_task(title, total=None, rate="", mean="-")
        rate = _Rate()

        def watch(report: Report) -> None:
            bar.update(
                task,
                total=report.steps,
                completed=report.step,
                rate=rate.text(report.step * len(report.seeds)),
                mean="-" if math.isnan(report.mean_return) else f"{report.mean_return:,.0f}",
            )

        yield watch


class _Rate:
    """Steps a second over the whole of this process' run, compilation apart: the first report starts the clock."""

    def __init__(self) -> None:
        self._first: tuple[int, float] | None = None

    def text(self, steps: int) -> str:
        now = time.perf_counter()
        if self._first is None or steps < self._first[0]:
            self._first = (steps, now)
            return "compiled"
        return f"{(steps - self._first[0]) / max(now - self._first[1], 1e-9):,.0f} steps/s"
