import math

import pytest

from perdure.home.sim.apartments import MACROS, MICROS, make_apartment
from perdure.home.sim.furniture import OPEN
from perdure.home.sim.occupancy import free_space

DRAWERS = ("drawer1_top", "drawer2_top", "drawer3")
STATES = {
    "closed": {},
    "counts as open": {"top_door": math.pi / 2 - 0.15},
    "wide open": {"top_door": OPEN} | dict.fromkeys(DRAWERS, 0.5),
}


@pytest.fixture(scope="session")
def apartments():
    """All 105 published apartments."""
    return [make_apartment(macro, micro) for macro in range(MACROS) for micro in range(MICROS)]


@pytest.fixture(scope="session")
def spaces(apartments):
    """The free space of each, with everything closed, the fridge as good as open, and everything wide open."""
    return [{name: free_space(apartment, opened) for name, opened in STATES.items()} for apartment in apartments]
