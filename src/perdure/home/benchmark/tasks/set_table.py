"""SetTable: bring the bowl from a closed drawer and the apple from the closed fridge to a table, then close both."""

from perdure.home.benchmark.tasks.sets import CLUTTERED, DRAWERS, FRIDGE_MIDDLE, MIDDLE_HALF, PANTRY, TABLE_1, TABLE_2
from perdure.home.benchmark.tasks.task import HomeTask, PlacementRule, TargetRule, make_stages, with_resets

_TABLES = (TABLE_1, TABLE_2)
_BOWL, _APPLE = ("024_bowl",), ("013_apple",)

SET_TABLE = HomeTask(
    name="set_table",
    targets=(
        TargetRule(PlacementRule(_BOWL, DRAWERS), PlacementRule(_BOWL, _TABLES)),
        TargetRule(PlacementRule(_APPLE, (FRIDGE_MIDDLE,), MIDDLE_HALF), PlacementRule(_APPLE, _TABLES)),
    ),
    clutter=((21, PlacementRule(PANTRY, CLUTTERED)), (2, PlacementRule(PANTRY, (FRIDGE_MIDDLE,)))),
    opened={},
    max_steps=4500,
    skills=with_resets(
        ("navigate", 0),
        ("open_drawer", 0),
        ("pick", 0),  # straight after the drawer is open, without navigating
        ("navigate", 0),
        ("place", 0),
        ("navigate", 0),
        ("close_drawer", 0),
        ("navigate", 1),
        ("open_fridge", 1),
        ("navigate", 1),
        ("pick", 1),
        ("navigate", 1),
        ("place", 1),
        ("navigate", 1),
        ("close_fridge", 1),
    ),
    stages=make_stages(
        {
            "open_0": ["opened_drawer()"],
            "pick_0": ["holding(0)"],
            "place_0": ["not_holding()", "at(0)"],
            "close_0": ["closed_drawer()", "at(0)"],
            "open_1": ["closed_drawer()", "at(0)", "opened_fridge()"],
            "pick_1": ["closed_drawer()", "at(0)", "opened_fridge()", "holding(1)"],
            "place_1": ["closed_drawer()", "at(0)", "not_holding()", "at(1)"],
            "close_1": ["closed_drawer()", "at(0)", "closed_fridge()", "at(1)"],
        }
    ),
)
"""M3: 2 targets and 23 other objects, 4500 steps."""
