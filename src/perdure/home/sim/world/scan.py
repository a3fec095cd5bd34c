"""The scan of the robot's surroundings: ranges from its center to obstacles of the base.

A Fetch makes such a scan from its laser, which looks 0.29 m above the floor, and from its head camera, which sees table
tops above and shelves below. Here it is computed from footprints: everything that reaches between 0.05 and 1.5 m
counts, with drawers and doors where they are now; loose objects do not.
"""

from __future__ import annotations

import numpy as np

from perdure.home.sim.apartments import Apartment, moving_footprints, static_footprints
from perdure.home.sim.arrays import FloatArray, IntArray

BEAMS = 24
"""OURS: few enough for a small network; the Fetch's own laser has 662 over 220 degrees."""
SCAN_RANGE = 5.0
"""OURS: ranges beyond are cut, in [m]."""
SCAN_ANGLES: FloatArray = np.linspace(0.0, 2.0 * np.pi, BEAMS, endpoint=False)
"""Of the beams, from straight ahead to the left."""
NO_SCAN: FloatArray = np.full(BEAMS, SCAN_RANGE)
NOTCH = 0.01
"""Drawers and doors count as open by multiples of it in [m] or [rad]: a footprint is looked up at each, not always."""


class Outlines:
    """Footprints around n lanes, kept ready for scanning."""

    def __init__(self, lanes: int) -> None:
        """Empty rooms."""
        self._apartments: list[Apartment | None] = [None] * lanes
        self._positions: list[FloatArray] = [np.zeros(0)] * lanes
        self._exact = [b""] * lanes
        self._static = [0] * lanes
        self._count = np.zeros(lanes, dtype=np.int64)
        self._rectangles = np.full((lanes, 1, 6), _NOTHING)

    def renew(self, lane: int, apartment: Apartment, positions: FloatArray) -> None:
        """Take over where drawers and doors of a lane are, in the order of the articulations. Shape (links,)."""
        known, exact = self._apartments[lane], positions.tobytes()
        if known is apartment and exact == self._exact[lane]:
            return
        self._exact[lane] = exact
        # Rounded, not compared with the last scan: otherwise a scan would depend on earlier ones.
        positions = np.round(positions / NOTCH) * NOTCH
        if known is not apartment:
            static = static_footprints(apartment)
            self._put(lane, 0, static)
            self._apartments[lane], self._static[lane] = apartment, len(static)
        elif np.array_equal(positions, self._positions[lane]):
            return
        self._positions[lane] = positions
        self._put(lane, self._static[lane], moving_footprints(apartment, positions))

    def scan(self, lanes: IntArray, base: FloatArray, reach: float = SCAN_RANGE) -> FloatArray:
        """Return ranges of some lanes (m,) in [m], `SCAN_RANGE` where nothing is within reach. Shape (m, BEAMS).

        `base` is x, y, heading of their robots, shape (m, 3).
        """
        boxes = self._within(lanes, base, reach)[:, None]  # (m, 1, n, 6)
        x, y, half_x, half_y, cos, sin = (boxes[..., k] for k in range(6))
        dx, dy = base[:, 0, None, None] - x, base[:, 1, None, None] - y
        at_x, at_y = cos * dx + sin * dy, cos * dy - sin * dx
        angle = (base[:, 2, None] + SCAN_ANGLES)[:, :, None]
        beam_x, beam_y = np.cos(angle), np.sin(angle)
        slow_x, slow_y = 1.0 / (beam_x * cos + beam_y * sin + NEVER_0), 1.0 / (beam_y * cos - beam_x * sin + NEVER_0)
        middle_x, spread_x = -at_x * slow_x, half_x * np.abs(slow_x)
        middle_y, spread_y = -at_y * slow_y, half_y * np.abs(slow_y)
        enter = np.maximum(np.maximum(middle_x - spread_x, middle_y - spread_y), 0.0)
        leave = np.minimum(middle_x + spread_x, middle_y + spread_y)
        ranges = np.where(leave >= enter, enter, SCAN_RANGE).min(axis=2)
        return np.where(ranges <= reach, ranges, SCAN_RANGE)

    def _within(self, lanes: IntArray, base: FloatArray, reach: float) -> FloatArray:
        """Return the rectangles that a beam may reach, filled up with ones that none does. Shape (m, n, 6)."""
        boxes = self._rectangles[lanes, : int(self._count[lanes].max(initial=1))]
        away = np.hypot(boxes[..., 0] - base[:, :1], boxes[..., 1] - base[:, 1:2])
        near = away - np.hypot(boxes[..., 2], boxes[..., 3]) <= reach
        most = max(int(near.sum(axis=1).max(initial=0)), 1)
        order = np.argsort(~near, axis=1, kind="stable")[:, :most]
        return np.take_along_axis(boxes, order[:, :, None], axis=1)

    def _put(self, lane: int, begin: int, rectangles: FloatArray) -> None:
        end = begin + len(rectangles)
        missing = end - self._rectangles.shape[1]
        if missing > 0:
            empty = np.full((len(self._count), missing, 6), _NOTHING)
            self._rectangles = np.concatenate([self._rectangles, empty], axis=1)
        self._rectangles[lane, begin:end, :4] = rectangles[:, :4]
        self._rectangles[lane, begin:end, 4] = np.cos(rectangles[:, 4])
        self._rectangles[lane, begin:end, 5] = np.sin(rectangles[:, 4])
        self._rectangles[lane, end:] = _NOTHING
        self._count[lane] = end


NEVER_0 = 1.1e-12
"""Added to the directions of beams: one along a side would divide by zero."""
_NOTHING = np.array([0.0, 0.0, -1.0, -1.0, 1.0, 0.0])
"""A rectangle that no beam hits: x, y, half lengths, cosine and sine of its heading."""
