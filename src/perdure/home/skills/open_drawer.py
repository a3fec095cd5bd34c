"""Open drawer: pull it to 0.45 m, within 0.05 m."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from perdure.home.skills.articulated import Articulated

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]


@dataclass(frozen=True)
class OpenDrawer(Articulated):
    """M3's success condition and reward."""

    name = "open_drawer"
    wanted = 0.45
    knows_front = True

    def there(self, position: FloatArray) -> BoolArray:
        """See `Articulated.there`."""
        there: BoolArray = np.abs(position - self.wanted) <= 0.05
        return there
