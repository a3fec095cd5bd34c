"""Training curves for TensorBoard, as one more watcher. Needs the extra ``perdure[tensorboard]``."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from perdure.ppo.errors import ConfigError

if TYPE_CHECKING:
    from perdure.ppo.runs import Report, Watcher


@contextmanager
def tensorboard(folder: Path) -> Iterator[Watcher]:
    """Gives a watcher that writes ``train/seed-N/mean_return`` at the seed's step.

    Raises:
        ConfigError: If tensorboardX is not installed.
    """
    try:
        from tensorboardX import SummaryWriter
    except ImportError:
        raise ConfigError("TensorBoard output needs tensorboardX: pip install 'perdure[tensorboard]'") from None
    writer = SummaryWriter(str(folder))

    def watch(report: Report) -> None:
        if not math.isnan(report.mean_return):
            writer.add_scalar(f"train/seed-{report.seed}/mean_return", report.mean_return, report.step)

    try:
        yield watch
    finally:
        writer.close()
