"""Clocks of several lanes, evaluated in one call."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from perdure.horizon.clock import Clock, clock_from_json
from perdure.horizon.errors import HorizonError


class LaneClocks:
    """The clocks of several lanes, evaluated in one call. Lanes with equal clocks are evaluated together."""

    def __init__(self, clocks: Sequence[Clock]) -> None:
        """Keep one clock for each lane.

        Args:
            clocks: At least one.

        Raises:
            HorizonError: If there is none.
        """
        if not clocks:
            raise HorizonError("LaneClocks needs at least one clock")
        self.clocks = tuple(clocks)
        self._kinds = tuple(dict.fromkeys(clocks))
        number = {kind: index for index, kind in enumerate(self._kinds)}
        self._kind_of_lane = np.array([number[clock] for clock in clocks])
        self._all_rows = self._group(self._kind_of_lane)

    def time(
        self, elapsed: ArrayLike, lanes: ArrayLike | None = None
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return (t, T) of every lane: two arrays of shape (n,).

        Args:
            elapsed: Steps since reset, shape (n,): one number for each of ``lanes``.
            lanes: Numbers of the lanes to evaluate; None means all of them, in order.

        Raises:
            HorizonError: If the shape does not fit, or there is no such lane.
        """
        steps = np.asarray(elapsed, np.float64)
        rows = self._all_rows if lanes is None else self._group(self._chosen(lanes))
        count = len(self.clocks) if lanes is None else np.size(lanes)
        if steps.shape != (count,):
            raise HorizonError(f"elapsed must have shape ({count},), one number a lane, got {steps.shape}")
        times, horizons = np.empty_like(steps), np.empty_like(steps)
        for clock, mine in rows:
            times[mine], horizons[mine] = clock.time(steps[mine])
        return times, horizons

    def to_json(self) -> dict[str, Any]:
        """Return the clocks in the order of their lanes, as plain JSON values."""
        return {"clocks": [clock.to_json() for clock in self.clocks]}

    @classmethod
    def from_json(cls, values: Any) -> Self:
        """Return the clocks that :meth:`to_json` described.

        Args:
            values: ``{"clocks": [...]}``.

        Raises:
            HorizonError: If there is no list of clocks, or one of them is unknown or out of range.
        """
        if not (isinstance(values, dict) and isinstance(values.get("clocks"), list)):
            raise HorizonError(f'the clocks of lanes are written {{"clocks": [...]}}, got {values!r}')
        return cls([clock_from_json(clock) for clock in values["clocks"]])

    def _chosen(self, lanes: ArrayLike) -> NDArray[np.int64]:
        chosen = np.asarray(lanes, np.int64)
        bad = chosen[(chosen < 0) | (chosen >= len(self.clocks))]
        if bad.size:
            raise HorizonError(f"there is no lane {bad[0]}; the lanes are 0 to {len(self.clocks) - 1}")
        return self._kind_of_lane[chosen]

    def _group(self, kind_of_row: NDArray[np.int64]) -> list[tuple[Clock, NDArray[np.int64]]]:
        return [(self._kinds[kind], np.flatnonzero(kind_of_row == kind)) for kind in np.unique(kind_of_row)]
