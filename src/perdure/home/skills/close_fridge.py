"""Close fridge: swing its door to 0, within 0.15 rad."""

from __future__ import annotations

from dataclasses import dataclass

from perdure.home.sim.world import PrivilegedState
from perdure.home.sim.world.state import turn
from perdure.home.skills.articulated import Articulated, success_text
from perdure.home.skills.open_fridge import OPENED, OpenFridge
from perdure.home.skills.skill import FloatArray, Recipe


@dataclass(frozen=True)
class CloseFridge(Articulated):
    """M3's success condition and start states (`close_fridge_v0A`).

    An open door hides its handle from a robot in front of the fridge, so the direction of the door is observed.
    """

    name = "close_fridge"
    closes = True
    wanted, accepted = 0.0, (-0.15, 0.15)
    success_text = success_text("the door is within 0.15 rad of 0")
    object_at_start = "goal"
    start_range = (OPENED, 2.356)
    start_rectangles = OpenFridge.start_rectangles
    navigation_region = OpenFridge.navigation_region
    recipe = Recipe(2_000_000, log_std_end=-2.0, log_std_fall=(0.5, 0.9))

    def front(self, state: PrivilegedState) -> FloatArray:
        """Return the direction in which the door faces; its hinge turns to the right as it opens."""
        return turn(super().front(state), -state.link_position)
