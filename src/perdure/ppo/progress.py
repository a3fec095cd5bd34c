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
                total=1.0,
                completed=report.share,
                rate=rate.text(report.seed, report.step),
                mean="-" if math.isnan(report.mean_return) else f"{report.mean_return:,.0f}",
            )

        yield watch


class _Rate:
    """Steps a second over the whole of this process' run, compilation apart: a seed's first report starts its clock."""

    def __init__(self) -> None:
        self._first: dict[int, int] = {}
        self._now: dict[int, int] = {}
        self._began = 0.0

    def text(self, seed: int, step: int) -> str:
        now = time.perf_counter()
        if not self._first:
            self._began = now
        self._first.setdefault(seed, step)
        self._now[seed] = step
        made = sum(self._now.values()) - sum(self._first.values())
        return f"{made / max(now - self._began, 1e-9):,.0f} steps/s" if made else "compiled"
