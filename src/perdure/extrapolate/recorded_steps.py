"""Steps at which a long evaluation records its lanes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

PER_DECADE = 10
"""Recorded steps for each factor of ten, so that a plot on a log axis is smooth."""
FEWEST_WINDOWS, MOST_WINDOWS = 100, 1000
"""Evenly spaced recorded steps, so that a plot on a linear axis is smooth. Rewards between two of them are judged."""
WINDOW = 1000
"""Steps between two evenly spaced ones, if their number allows it: the length of an ordinary episode."""


def window_steps(steps: int) -> NDArray[np.int64]:
    """Return rising step numbers, evenly spaced, up to ``steps``."""
    count = min(steps, max(FEWEST_WINDOWS, min(MOST_WINDOWS, steps // WINDOW)))
    return np.ceil(np.linspace(0, steps, count + 1)[1:]).astype(np.int64)


def recorded_steps(steps: int) -> NDArray[np.int64]:
    """Return rising step numbers from 1 to ``steps``, evenly spaced on a log axis and on a linear axis."""
    decades = np.log10(steps)
    log = np.round(np.logspace(0, decades, int(np.ceil(decades * PER_DECADE)) + 1))
    return np.unique(np.concatenate([log, window_steps(steps), [steps]])).astype(np.int64)
