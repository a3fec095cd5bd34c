"""Close fridge: swing its door to 0, within 0.15 rad."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from perdure.home.sim.world import PrivilegedState
from perdure.home.sim.world.state import turn
from perdure.home.skills.articulated import Articulated

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]


@dataclass(frozen=True)
class CloseFridge(Articulated):
    """M3's success condition and reward.

    An open door hides its handle from a robot in front of the fridge, so it is told which way the door visuals.
    """

    name = "close_fridge"
    wanted = 0.0
    knows_front = True

    def there(self, position: FloatArray) -> BoolArray:
        """See `Articulated.there`."""
        there: BoolArray = np.abs(position - self.wanted) <= 0.15
        return there

    def front(self, state: PrivilegedState) -> FloatArray:
        """See `Articulated.front`: the hinge turns to the right as the door opens."""
        return turn(super().front(state), -state.link_position)
