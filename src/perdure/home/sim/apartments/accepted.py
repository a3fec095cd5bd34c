"""Which draw of each published apartment is the first good one, so that nobody has to check them again.

A check takes a tenth of a second, and an environment for training needs dozens of apartments.
`tests/home/sim/apartments` draws and checks them all; after a change of macro layouts, furniture or checks it names the
values that belong here.
"""

from __future__ import annotations

from collections.abc import Mapping

THROWN_AWAY: Mapping[int, tuple[int, ...]] = {
    0: (5, 3, 7, 0, 10, 20, 1, 3, 1, 6, 1, 1, 1, 0, 1, 0, 5, 5, 0, 7, 0),
    1: (1, 0, 2, 0, 4, 2, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 1, 0, 0),
    2: (0, 0, 0, 4, 0, 0, 0, 1, 1, 2, 1, 1, 0, 3, 0, 0, 1, 0, 1, 1, 1),
    3: (0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 2, 0, 1, 0, 0, 0, 0),
    4: (0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 1, 0, 1),
}
"""Macro layout to the number of draws of each micro variation, with seed 0, that failed a check."""
