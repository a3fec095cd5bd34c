"""Steps at which a long evaluation records its lanes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

PER_DECADE = 10
"""Checkpoints for each factor of ten, so that a plot over log steps is smooth."""
FEWEST_WINDOWS, MOST_WINDOWS = 100, 1000
"""Checkpoints spread evenly, so that a plot over steps is smooth too. Rewards between two of them are judged."""
WINDOW = 1000
"""Steps between two of those, as far as their number allows: the length of an ordinary episode."""


def window_steps(steps: int) -> NDArray[np.int64]:
    """Return rising step numbers, evenly spaced, up to ``steps``."""
    count = min(steps, max(FEWEST_WINDOWS, min(MOST_WINDOWS, steps // WINDOW)))
    return np.ceil(np.linspace(0, steps, count + 1)[1:]).astype(np.int64)


def checkpoint_steps(steps: int) -> NDArray[np.int64]:
    """Return rising step numbers from 1 to ``steps``, evenly spaced on a log axis and on a linear axis."""
    decades = np.log10(steps)
    log = np.round(np.logspace(0, decades, int(np.ceil(decades * PER_DECADE)) + 1))
    return np.unique(np.concatenate([log, window_steps(steps), [steps]])).astype(np.int64)
