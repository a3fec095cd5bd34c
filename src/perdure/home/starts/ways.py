"""Ways to where a skill can be done, kept: many starts share an apartment."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache

from perdure.home.layouts import Apartment, Geodesic
from perdure.home.skills import Aim, region
from perdure.home.starts.containers import is_drawer

DRAWER_OPEN, FRIDGE_OPEN = (0.4, 0.45, 0.5), (1.5, 1.8, 2.1, 2.35)
"""OURS: how far drawers and the door are open as far as ways are concerned, so that these can be kept; [m], [rad]."""


def way_for(apartment: Apartment, opened: Mapping[str, float], aim: Aim) -> Geodesic:
    """The way to where the robot may stand for an aim, past drawers and a door that are open about so far."""
    rounded = {
        link: min(DRAWER_OPEN if is_drawer(apartment, link) else FRIDGE_OPEN, key=lambda q: abs(q - position))
        for link, position in opened.items()
    }
    return _way(apartment, tuple(sorted(rounded.items())), aim)


@lru_cache(maxsize=1024)
def _way(apartment: Apartment, opened: tuple[tuple[str, float], ...], aim: Aim) -> Geodesic:
    """At most 0.3 MB each."""
    space, cells = region(apartment, dict(opened), aim)
    return space.distances(cells)
