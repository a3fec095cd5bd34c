"""At which steps a long evaluation writes down where its lanes are."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

PER_DECADE = 10
"""Checkpoints for each factor of ten, so that a plot over log steps is smooth."""
LINEAR = 100
"""Checkpoints spread evenly, so that a plot over steps is smooth too."""


def checkpoint_steps(steps: int) -> NDArray[np.int64]:
    """Rising step numbers from 1 to ``steps``, evenly spaced on a log axis and, beside them, on a linear one."""
    decades = np.log10(steps)
    log = np.round(np.logspace(0, decades, int(np.ceil(decades * PER_DECADE)) + 1))
    linear = np.ceil(np.linspace(0, steps, min(LINEAR, steps) + 1)[1:])
    return np.unique(np.concatenate([log, linear, [steps]])).astype(np.int64)
