"""The running lanes of one `Policy`; phi is computed once if all clocks are constant."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from perdure.horizon import Clock, Constant, LaneClocks

if TYPE_CHECKING:
    from perdure.policy.policy import Policy

FloatArray = NDArray[np.float64]


class PolicyLanes:
    """See `perdure.policy.policy_like.ActingLanes`. A row's action depends on no other row."""

    def __init__(self, policy: Policy, clocks: Sequence[Clock | None]) -> None:
        """Begin one lane for each clock."""
        self._policy = policy
        self._set(list(clocks))

    def act(self, observations: FloatArray, elapsed: int) -> FloatArray:
        """See `ActingLanes.act`."""
        return self._policy.act_with(observations, self._embed(elapsed) if self._phi is None else self._phi)

    def keep(self, rows: NDArray[np.bool_]) -> None:
        """See `ActingLanes.keep`."""
        self._set([clock for clock, stays in zip(self._clocks, rows, strict=True) if stays])

    def _set(self, clocks: list[Clock | None]) -> None:
        self._clocks = clocks
        known = [clock for clock in clocks if clock is not None]
        self._lane_clocks = LaneClocks(known) if known else None
        # phi is the same at every step under constant clocks and for policies without phi.
        self._phi = self._embed(0) if all(isinstance(clock, Constant) for clock in known) else None

    def _embed(self, elapsed: int) -> FloatArray:
        steps = np.full(len(self._clocks), float(elapsed))
        times, horizons = (steps, steps) if self._lane_clocks is None else self._lane_clocks.time(steps)
        return self._policy.embed(times, horizons)
