"""Close fridge begins in front of the open fridge (M3, `close_fridge_v0A`)."""

from __future__ import annotations

import numpy as np

from perdure.home.benchmark.episodes import Episode
from perdure.home.skills.starts.articulated import container_of, start_at_handle
from perdure.home.skills.starts.open_fridge import RECTANGLES
from perdure.home.skills.starts.start import Start

OPEN = (np.pi / 2.0 - 0.15, 2.356)
"""The door's position is uniform in this range in [rad] (M3)."""


def draw(episode: Episode, target: int, rng: np.random.Generator) -> Start:
    """See `Draw`."""
    link = container_of(episode, target)
    fridge = episode.apartment().piece_of(link).pose
    opened = {link: float(rng.uniform(*OPEN))}
    return start_at_handle(episode, target, "close_fridge", (fridge, RECTANGLES), opened, rng)
