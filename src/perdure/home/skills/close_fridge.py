"""Close fridge: swing its door to 0, within 0.15 rad."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from perdure.home.skills.articulated import Articulated

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]


@dataclass(frozen=True)
class CloseFridge(Articulated):
    """M3's success condition and reward."""

    name = "close_fridge"
    wanted = 0.0

    def there(self, position: FloatArray) -> BoolArray:
        """See `Articulated.there`."""
        there: BoolArray = np.abs(position - self.wanted) <= 0.15
        return there
