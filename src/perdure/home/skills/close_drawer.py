"""Close drawer: push it to 0, within 0.05 m."""

from __future__ import annotations

from dataclasses import dataclass

from perdure.home.skills.articulated import Articulated, success_text
from perdure.home.skills.skill import Recipe
from perdure.home.skills.starts import DRAWER_OPEN, Rectangle


@dataclass(frozen=True)
class CloseDrawer(Articulated):
    """M3's success condition and start states (`close_drawer_v0A`), except that the other drawers are closed."""

    name = "close_drawer"
    closes = True
    knows_front = False
    wanted, accepted = 0.0, (-0.05, 0.05)
    success_text = success_text("the drawer is within 0.05 m of 0")
    object_at_start = "goal"
    start_range = DRAWER_OPEN
    start_rectangles = (Rectangle((0.3, 1.0), 0.6),)
    navigation_region = Rectangle((0.30, 0.45), 0.35)
    recipe = Recipe(1_000_000)
