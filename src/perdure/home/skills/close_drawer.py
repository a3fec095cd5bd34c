"""Close drawer: push it to 0, within 0.05 m."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from perdure.home.sim.apartments import Apartment
from perdure.home.skills.articulated import Articulated, success_text
from perdure.home.skills.progress import BoolArray, FloatArray
from perdure.home.skills.recipe import Recipe
from perdure.home.skills.starts.containers import draw_open
from perdure.home.skills.starts.stand import Rectangle


@dataclass(frozen=True)
class CloseDrawer(Articulated):
    """M3's success condition and start states (`close_drawer_v0A`)."""

    name = "close_drawer"
    wanted = 0.0
    closes = True
    knows_front = False
    object_at_start = "goal"
    success_text = success_text("the drawer is within 0.05 m of 0")
    begins_in = (Rectangle((0.3, 1.0), 0.6),)
    reached_from = Rectangle((0.30, 0.45), 0.35)
    recipe = Recipe(1_000_000)

    def there(self, position: FloatArray) -> BoolArray:
        """See `Articulated.there`."""
        there: BoolArray = np.abs(position - self.wanted) <= 0.05
        return there

    def draw_opened(self, apartment: Apartment, link: str, rng: np.random.Generator) -> dict[str, float]:
        """Open the drawer by U(0.4, 0.5) m."""
        return draw_open(apartment, link, rng)
