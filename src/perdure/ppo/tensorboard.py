"""Training curves for TensorBoard. Needs the extra ``perdure[tensorboard]``."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from perdure.ppo.errors import ConfigError

if TYPE_CHECKING:
    from perdure.ppo.training import Report


@contextmanager
def tensorboard(folder: Path) -> Iterator[Callable[[Report], None]]:
    """Return a function of reports that writes ``train/seed-N/mean_return`` at the seed's step.

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
