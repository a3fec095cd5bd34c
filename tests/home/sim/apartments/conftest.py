import math

import pytest

from perdure.home.sim.apartments import LAYOUTS, make_apartment
from perdure.home.sim.occupancy import free_space
from perdure.home.tasks.tasks import TASKS

DRAWERS = ("drawer1_top", "drawer2_top", "drawer3")
STATES = {
    "closed": {},
    "counts as open": {"top_door": math.pi / 2 - 0.15},
    "wide open": {"top_door": TASKS["prepare_groceries"].opened["top_door"]} | dict.fromkeys(DRAWERS, 0.5),
}


@pytest.fixture(scope="session")
def apartments():
    """All 125 published apartments: 21 of each of five layouts, then 4 of each of five more."""
    return [
        make_apartment(macro, micro) for macro, each in enumerate(LAYOUTS) for micro in range(len(each.rejected_draws))
    ]


@pytest.fixture(scope="session")
def spaces(apartments):
    """The free space of each, with everything closed, the fridge as good as open, and everything wide open."""
    return [{name: free_space(apartment, opened) for name, opened in STATES.items()} for apartment in apartments]
