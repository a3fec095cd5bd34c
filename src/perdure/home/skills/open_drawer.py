"""Open drawer: pull it to 0.45 m, within 0.05 m; its stop is at 0.5 m."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from perdure.home.sim.apartments import Apartment
from perdure.home.skills.articulated import Articulated, success_text
from perdure.home.skills.skill import Recipe
from perdure.home.skills.starts import Rectangle

GIVE = 0.005
"""Yield of the simulated stop to a pulling hand in [m]; a drawer at its stop is open (OURS)."""
OTHERS = 0.1
"""Largest initial opening of the other drawers, drawn uniformly, in [m] (OURS; in M3 they are closed here, and a random
subset of them is open by up to this in `close_drawer`)."""


@dataclass(frozen=True)
class OpenDrawer(Articulated):
    """M3's success condition and start states (`open_drawer_v0A`), except for the other drawers, see `OTHERS`."""

    name = "open_drawer"
    wanted, accepted = 0.45, (0.45 - 0.05, 0.45 + 0.05 + GIVE)
    success_text = success_text("the drawer is within 0.05 m of 0.45 m (at its stop it may be 5 mm beyond)")
    start_rectangles = (Rectangle((0.3, 1.5), 0.6),)
    navigation_region = Rectangle((0.80, 0.95), 0.35)
    recipe = Recipe(2_000_000, log_std_end=-2.0, log_std_fall=(0.5, 0.9))

    def draw_opened(self, apartment: Apartment, link: str, rng: np.random.Generator) -> dict[str, float]:
        """Draw the positions of the other drawers, which are not quite closed."""
        drawers = [each.link for each in apartment.articulations if each.kind == "slide" and each.link != link]
        return {each: float(rng.uniform(0.0, OTHERS)) for each in drawers}
