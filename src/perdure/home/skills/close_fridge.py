"""Close fridge: swing its door to 0, within 0.15 rad."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from perdure.home.sim.apartments import Apartment
from perdure.home.sim.world import PrivilegedState
from perdure.home.sim.world.state import turn
from perdure.home.skills.articulated import Articulated, success_text
from perdure.home.skills.open_fridge import REGION, START_RECTANGLES
from perdure.home.skills.progress import BoolArray, FloatArray
from perdure.home.skills.recipe import Recipe

OPEN = (np.pi / 2.0 - 0.15, 2.356)
"""Uniform range of the door position at the start in [rad] (M3)."""


@dataclass(frozen=True)
class CloseFridge(Articulated):
    """M3's success condition and start states (`close_fridge_v0A`).

    An open door hides its handle from a robot in front of the fridge, so the direction of the door is observed.
    """

    name = "close_fridge"
    wanted = 0.0
    closes = True
    object_at_start = "goal"
    success_text = success_text("the door is within 0.15 rad of 0")
    begins_in = START_RECTANGLES
    reached_from = REGION
    recipe = Recipe(2_000_000, log_std_end=-2.0, log_std_fall=(0.5, 0.9))

    def there(self, position: FloatArray) -> BoolArray:
        """See `Articulated.there`."""
        there: BoolArray = np.abs(position - self.wanted) <= 0.15
        return there

    def draw_opened(self, apartment: Apartment, link: str, rng: np.random.Generator) -> dict[str, float]:
        """Draw the door position."""
        return {link: float(rng.uniform(*OPEN))}

    def front(self, state: PrivilegedState) -> FloatArray:
        """Return the direction in which the door faces; its hinge turns to the right as it opens."""
        return turn(super().front(state), -state.link_position)
