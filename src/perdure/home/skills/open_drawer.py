"""Open drawer: pull it to 0.45 m, within 0.05 m; its stop is at 0.5 m."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from perdure.home.skills.articulated import Articulated

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

TOLERANCE = 0.05
"""In [m] (M3)."""
GIVE = 0.005
"""By so much a simulated stop gives to a hand that pulls, in [m]: at the stop a drawer is open (OURS)."""


@dataclass(frozen=True)
class OpenDrawer(Articulated):
    """M3's success condition and reward."""

    name = "open_drawer"
    wanted = 0.45
    knows_front = True

    def there(self, position: FloatArray) -> BoolArray:
        """See `Articulated.there`."""
        there: BoolArray = (position >= self.wanted - TOLERANCE) & (position <= self.wanted + TOLERANCE + GIVE)
        return there
