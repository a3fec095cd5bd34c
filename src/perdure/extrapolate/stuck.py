"""Noticing silent failure: a lane that lives on and achieves nothing, such as a cheetah on its back.

Definition. A lane's steps are cut into windows of WINDOW steps. A window is a stuck phase if the reward earned in it is
below SHARE of the reward earned in the lane's first window. A lane whose first window earned nothing, or less, has
nothing to fall behind and is never called stuck.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

WINDOW = 1000
"""Steps in one window: the length of an ordinary episode."""
SHARE = 0.1
"""Share of the first window's reward below which a window counts as stuck."""


class StuckWatch:
    """Counts the steps that lanes have spent in stuck phases."""

    def __init__(self, lanes: int) -> None:
        """Starts before the first step of ``lanes`` lanes."""
        self._first = np.zeros(lanes)
        self._earned = np.zeros(lanes)
        self._stuck = np.zeros(lanes, np.int64)

    @property
    def stuck_steps(self) -> NDArray[np.int64]:
        """Steps in stuck phases that are complete, shape (lanes,)."""
        return self._stuck

    def add(self, lanes: NDArray[np.int64], rewards: NDArray[np.float64], elapsed: int) -> None:
        """Takes in the rewards of living lanes, shape (n,), for the step that made ``elapsed`` steps."""
        self._earned[lanes] += rewards
        if elapsed % WINDOW:
            return
        if elapsed == WINDOW:
            self._first[lanes] = self._earned[lanes]
        else:
            first = self._first[lanes]
            self._stuck[lanes[(first > 0) & (self._earned[lanes] < SHARE * first)]] += WINDOW
        self._earned[lanes] = 0.0
