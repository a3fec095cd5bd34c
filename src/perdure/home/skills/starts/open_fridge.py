"""Open fridge begins in front of the closed fridge (M3, `open_fridge_v0A`)."""

from __future__ import annotations

import numpy as np

from perdure.home.benchmark.episodes import Episode
from perdure.home.skills.starts.articulated import container_of, start_at_handle
from perdure.home.skills.starts.start import Start

RECTANGLES = (((0.933, 1.833), 0.6), ((0.8, 2.0), 1.0))
"""In the fridge's frame in [m]; the second where the first has no free cell (M3)."""


def draw(episode: Episode, target: int, rng: np.random.Generator) -> Start:
    """See `Draw`."""
    fridge = episode.apartment().piece_of(container_of(episode, target)).pose
    return start_at_handle(episode, target, "open_fridge", (fridge, RECTANGLES), {}, rng)
