"""Open drawer begins in front of its handle; the other drawers are not quite closed (M3, `open_drawer_v0A`)."""

from __future__ import annotations

import numpy as np

from perdure.home.benchmark.episodes import Episode
from perdure.home.skills.starts.articulated import container_of, start_at_handle
from perdure.home.skills.starts.containers import handle_frame
from perdure.home.skills.starts.start import Start

RECTANGLE = ((0.3, 1.5), 0.6)
"""Before the handle in [m] (M3)."""
OTHERS = 0.1
"""The other drawers are open by up to this, uniformly, in [m] (M3)."""


def draw(episode: Episode, target: int, rng: np.random.Generator) -> Start:
    """See `Draw`."""
    apartment, link = episode.apartment(), container_of(episode, target)
    drawers = [each.link for each in apartment.articulations if each.kind == "slide" and each.link != link]
    opened = {each: float(rng.uniform(0.0, OTHERS)) for each in drawers}
    before = handle_frame(apartment, link, 0.0), (RECTANGLE,)
    return start_at_handle(episode, target, "open_drawer", before, opened, rng)
