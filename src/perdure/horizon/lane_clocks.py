"""One batch, many clocks: each lane is told its own time."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from perdure.horizon.clock import Clock
from perdure.horizon.errors import HorizonError


class LaneClocks:
    """The clocks of n lanes, read all at once. Lanes with equal clocks are read together."""

    def __init__(self, clocks: Sequence[Clock]) -> None:
        """Takes one clock for each lane.

        Args:
            clocks: At least one.

        Raises:
            HorizonError: If there is none.
        """
        if not clocks:
            raise HorizonError("LaneClocks needs at least one clock")
        self.clocks = tuple(clocks)
        kinds = dict.fromkeys(clocks)
        self._rows = [(kind, np.flatnonzero([clock == kind for clock in clocks])) for kind in kinds]

    def subset(self, lanes: NDArray[np.int64]) -> LaneClocks:
        """The clocks of these lanes alone; made once, when the set of living lanes changes."""
        return LaneClocks([self.clocks[lane] for lane in lanes])

    def time(self, elapsed: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """(t, T) of every lane: two arrays of shape (n,), for steps since reset of shape (n,)."""
        steps = np.asarray(elapsed, np.float64)
        if steps.shape != (len(self.clocks),):
            raise HorizonError(f"elapsed must have shape ({len(self.clocks)},), one number a lane, got {steps.shape}")
        if len(self._rows) == 1:
            return self._rows[0][0].time(steps)
        times, horizons = np.empty_like(steps), np.empty_like(steps)
        for clock, rows in self._rows:
            times[rows], horizons[rows] = clock.time(steps[rows])
        return times, horizons
