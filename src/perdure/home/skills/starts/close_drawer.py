"""Close drawer begins in front of the open drawer's handle (M3, `close_drawer_v0A`)."""

from __future__ import annotations

import numpy as np

from perdure.home.benchmark.episodes import Episode
from perdure.home.skills.starts.articulated import container_of, start_at_handle
from perdure.home.skills.starts.containers import draw_open, handle_frame
from perdure.home.skills.starts.start import Start

RECTANGLE = ((0.3, 1.0), 0.6)
"""Before the handle of the open drawer in [m] (M3)."""


def draw(episode: Episode, target: int, rng: np.random.Generator) -> Start:
    """See `Draw`; the drawer is open by U(0.4, 0.5) m."""
    apartment, link = episode.apartment(), container_of(episode, target)
    opened = draw_open(apartment, link, rng)
    before = handle_frame(apartment, link, opened[link]), (RECTANGLE,)
    return start_at_handle(episode, target, "close_drawer", before, opened, rng)
