"""Open fridge: swing its door to at least pi/2 - 0.15 rad."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from perdure.home.skills.articulated import Articulated, success_text
from perdure.home.skills.skill import Recipe
from perdure.home.skills.starts import Rectangle

OPENED = np.pi / 2.0 - 0.15


@dataclass(frozen=True)
class OpenFridge(Articulated):
    """M3's success condition and start states (`open_fridge_v0A`)."""

    name = "open_fridge"
    wanted, accepted = OPENED, (OPENED, np.inf)
    success_text = success_text("the door is at pi/2 - 0.15 rad or beyond")
    start_rectangles = (Rectangle((0.933, 1.833), 0.6), Rectangle((0.8, 2.0), 1.0))
    navigation_region = Rectangle((0.9, 1.8), 0.5)
    recipe = Recipe(2_000_000, log_std_end=-2.0, log_std_fall=(0.5, 0.9))
