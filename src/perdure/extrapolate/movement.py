"""Measure how much lanes move, and which observation component leaves its training range first."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from perdure.policy import LaneStep, PolicyLike

EVERY = 10
"""Steps between two measurements; the events of interest last much longer."""
MARGIN = 0.5
"""A component has left its training range if it is outside by more than this share of the range."""


class MovementRecorder:
    """Mean movement per step in the first and the last tenth of the test horizon, and training ranges left.

    Movement of a step: the mean over components of |o_{t+1} - o_t| in training standard deviations.
    """

    def __init__(self, policies: list[PolicyLike], steps: int) -> None:
        """Start before the first step, with one policy for each lane."""
        lanes, size = len(policies), policies[0].task.observation_size
        std = np.stack([policy.observation_std for policy in policies])
        self._per_deviation = np.where(std > 1e-6, 1.0 / np.maximum(std, 1e-6), 0.0)
        self._low, self._high = np.full((lanes, size), -np.inf), np.full((lanes, size), np.inf)
        for lane, policy in enumerate(policies):
            if policy.reference is not None:
                low, high = policy.reference.observation_low, policy.reference.observation_high
                self._low[lane], self._high[lane] = low - MARGIN * (high - low), high + MARGIN * (high - low)
        self._tenth, self._last_start = max(1, steps // 10), steps - max(1, steps // 10)
        self._sums, self._counts = np.zeros((2, lanes)), np.zeros((2, lanes))
        self.left_step = np.zeros(lanes, np.int64)
        """Step at which a component was first seen outside; 0: never."""
        self.left_component = np.full(lanes, -1)

    def take(self, lane_step: LaneStep, step: int) -> None:
        """Record the lanes of this step, if it is a recording step."""
        if step % EVERY:
            return
        lanes, after = lane_step.lanes, lane_step.step.observations
        part = 0 if step <= self._tenth else 1 if step > self._last_start else None
        with np.errstate(invalid="ignore", over="ignore"):
            if part is not None:
                moved = (np.abs(after - lane_step.before) * self._per_deviation[lanes]).mean(axis=1)
                known = np.isfinite(moved)
                self._sums[part, lanes[known]] += moved[known]
                self._counts[part, lanes[known]] += 1
            outside = (after < self._low[lanes]) | (after > self._high[lanes])
        new = outside.any(axis=1) & (self.left_step[lanes] == 0)
        self.left_step[lanes[new]] = step
        self.left_component[lanes[new]] = outside[new].argmax(axis=1)

    @property
    def movement(self) -> NDArray[np.float64]:
        """Mean movement per step in the first and the last tenth, shape (2, lanes); nan where nothing was seen."""
        result: NDArray[np.float64] = np.divide(
            self._sums, self._counts, out=np.full_like(self._sums, np.nan), where=self._counts > 0
        )
        return result
