"""TidyHouse: five objects from open surfaces to other places on open surfaces."""

from perdure.home.benchmark.tasks.sets import OPEN_SURFACES, PANTRY
from perdure.home.benchmark.tasks.task import (
    HomeTask,
    PlacementRule,
    TargetRule,
    pick_and_place_skills,
    pick_and_place_stages,
)

_ANYWHERE = PlacementRule(PANTRY, OPEN_SURFACES)

TIDY_HOUSE = HomeTask(
    name="tidy_house",
    targets=(TargetRule(_ANYWHERE, _ANYWHERE),) * 5,
    clutter=((20, _ANYWHERE),),
    opened={},
    max_steps=5000,
    skills=pick_and_place_skills(5),
    stages=pick_and_place_stages(5),
)
"""M3: 25 objects of which 5 are targets, nothing is opened, 5000 steps, stages pick_0, place_0, ..., place_4."""
