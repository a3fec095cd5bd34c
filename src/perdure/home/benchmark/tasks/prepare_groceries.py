"""PrepareGroceries: two objects from the open fridge to the counter, one from the counter into the fridge."""

from perdure.home.benchmark.tasks.sets import CLUTTERED, COUNTER_LEFT, COUNTER_RIGHT, FRIDGE_MIDDLE, MIDDLE_HALF, PANTRY
from perdure.home.benchmark.tasks.task import (
    HomeTask,
    PlacementRule,
    TargetRule,
    pick_and_place_skills,
    pick_and_place_stages,
)

_FRIDGE = PlacementRule(PANTRY, (FRIDGE_MIDDLE,), MIDDLE_HALF)
_COUNTER = PlacementRule(PANTRY, (COUNTER_RIGHT, COUNTER_LEFT))

PREPARE_GROCERIES = HomeTask(
    name="prepare_groceries",
    targets=(TargetRule(_FRIDGE, _COUNTER), TargetRule(_FRIDGE, _COUNTER), TargetRule(_COUNTER, _FRIDGE)),
    clutter=((21, PlacementRule(PANTRY, CLUTTERED)), (1, PlacementRule(PANTRY, (FRIDGE_MIDDLE,)))),
    opened={"top_door": 2.356},
    max_steps=4000,
    skills=pick_and_place_skills(3),
    stages=pick_and_place_stages(3),
)
"""M3: 3 targets and 22 other objects, the fridge stands open at 2.356 rad, 4000 steps, stages pick_0 to place_2."""
