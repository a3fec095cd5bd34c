"""The progress of a training run: reports for a function of the caller's, and curves for TensorBoard."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from perdure.errors import PerdureError
from perdure.runs import Observer, Status
from perdure.runs.progress import total_share

if TYPE_CHECKING:
    from perdure.learn.run import TrainRun

DIAGNOSTICS = "diagnostics/"
"""Begins the names of an algorithm's own numbers among the facts of a report. TensorBoard shows them, the line of
progress does not."""


@dataclass(frozen=True)
class Report:
    """Progress report of a training run."""

    seed: int
    """Seed that has made progress."""
    step: int
    """Environment steps it has made."""
    steps: int
    """Environment steps it will have made in all."""
    mean_return: float
    """Mean undiscounted return of its last 20 training episodes; nan before the first has ended."""
    share: float
    """Share of the work that is done, all seeds together, from 0 to 1."""
    reward_per_step: float = math.nan
    """Mean reward of a step in these episodes. Other than the return, it compares methods whose episodes have other
    lengths."""
    mean_length: float = math.nan
    """Mean length of these episodes in steps."""
    diagnostics: Mapping[str, float] = field(default_factory=dict)
    """The algorithm's own numbers of its last iteration, such as its losses."""


def on_report(run: TrainRun, callback: Callable[[Report], None]) -> Observer:
    """Return an observer that calls `callback` with a `Report` whenever a seed has made progress."""
    last: dict[int, float] = {}

    def observe(status: Status) -> None:
        for seed in run.seeds:
            progress = status[run.key(seed)]
            if progress.facts and progress.done != last.get(seed):
                last[seed] = progress.done
                facts = progress.facts
                report = Report(
                    seed=seed,
                    step=int(progress.done),
                    steps=int(progress.total),
                    mean_return=facts.get("return", math.nan),
                    share=total_share(status),
                    reward_per_step=facts.get("reward_per_step", math.nan),
                    mean_length=facts.get("length", math.nan),
                    diagnostics={
                        name.removeprefix(DIAGNOSTICS): value
                        for name, value in facts.items()
                        if name.startswith(DIAGNOSTICS)
                    },
                )
                callback(report)

    return observe


@contextmanager
def tensorboard(folder: Path) -> Iterator[Callable[[Report], None]]:
    """Return a function of reports that writes them for TensorBoard, at the seed's step.

    The curves are ``train/seed-N/mean_return``, ``mean_length``, ``reward_per_step`` and the algorithm's own, such as
    ``approx_kl`` and ``explained_variance``.

    Raises:
        PerdureError: If tensorboardX is not installed.
    """
    try:
        from tensorboardX import SummaryWriter
    except ImportError:
        raise PerdureError("TensorBoard output needs tensorboardX: pip install 'perdure[tensorboard]'") from None
    writer = SummaryWriter(str(folder))

    def watch(report: Report) -> None:
        values = {name: getattr(report, name) for name in ("mean_return", "mean_length", "reward_per_step")}
        values.update(report.diagnostics)
        for name, value in values.items():
            if not math.isnan(value):
                writer.add_scalar(f"train/seed-{report.seed}/{name}", value, report.step)

    try:
        yield watch
    finally:
        writer.close()
