"""Names of the study's tables and figures: tasks, worlds, release strategies, groups of objects."""

from __future__ import annotations

GROUPS = {"sphere": "apples", "bowl": "bowls", "cylinder": "cans", "box": "boxes", "rounded_box": "boxes"}
"""Collision shape to what tables call objects of that shape."""
RELEASE_STRATEGIES = ("rl", "delta-10", "delta-50", "delta-50-in-200", "delta-200", "stop", "ik", "ik+")
"""In the order of tables and figures."""
WORLDS = {
    "drag": "drag only",
    "drag hull-apple": "the same, apple a convex hull",
    "drag base-velocity-removed": "the same, base velocity removed at release",
    "drag released-at-zero-velocity": "the same, all velocity removed at release",
    "": "rolling friction",
    "jaws-apart drag": "drag only, `--jaws apart`",
}
"""World, as `strategy_name` writes it, to its name in tables."""
TITLES = {"set_table": "SetTable", "tidy_house": "TidyHouse", "prepare_groceries": "PrepareGroceries"}
SPLITS = {"val": "layouts known from training", "eval": "an unseen layout"}
"""Split to words."""
