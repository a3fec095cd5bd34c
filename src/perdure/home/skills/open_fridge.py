"""Open fridge: swing its door to at least pi/2 - 0.15 rad."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from perdure.home.skills.articulated import Articulated

OPENED = np.pi / 2.0 - 0.15

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]


@dataclass(frozen=True)
class OpenFridge(Articulated):
    """M3's success condition and reward."""

    name = "open_fridge"
    wanted = OPENED
    knows_front = True

    def there(self, position: FloatArray) -> BoolArray:
        """See `Articulated.there`."""
        there: BoolArray = position >= OPENED
        return there
