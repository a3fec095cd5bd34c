"""The figure of release strategies: every task on unseen layouts, then SetTable in the other worlds."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from perdure.report import wording
from perdure.report.axes import Axis
from perdure.report.render import Figure
from perdure.report.rows import Points, point_chart
from perdure.report.theme import style
from perdure.studies.placement.names import TITLES, WORLDS
from perdure.studies.placement.results import Results, Row, chosen, strategy_and_world

LABELS = {"rl": "policy alone", "stop": "stop, then release", "ik": "stop, lower 5 cm, release"}
SHORT = {
    "drag hull-apple": "apple a convex hull",
    "drag base-velocity-removed": "base velocity removed",
    "drag released-at-zero-velocity": "released at zero velocity",
    "": "rolling friction",
}
"""World to its name after "SetTable"."""
PLACES = {
    **{(task, "drag"): title for task, title in TITLES.items()},
    **{("set_table", world): f"SetTable, {SHORT[world]}" for world in WORLDS if world in SHORT},
}
"""Task and world to the name of their row in the figure."""


def strategy_figures(results: Results) -> Iterator[Figure]:
    """Yield the figure where there are rows for it."""
    rows = {
        (row["task"], *strategy_and_world(row)): row
        for row in chosen(results.rows, "eval")
        if (row["task"], strategy_and_world(row)[1]) in PLACES
    }
    found = {key: row for key, row in rows.items() if key[1] in LABELS}
    places = [place for place in PLACES if any((task, world) == place for task, _, world in found)]
    if places:
        yield _figure(found, places)


def _figure(found: dict[tuple[str, str, str], Row], places: list[tuple[str, str]]) -> Figure:
    points = [_points(found, places, number, strategy) for number, strategy in enumerate(LABELS)]
    seeds = wording.sample([row["seeds"]["train"] for row in found.values()], "training seed").removesuffix(" each")
    per_seed = wording.sample([row["episodes"] // row["seeds"]["train"] for row in found.values()], "episode")
    return Figure(
        "strategies",
        "Does the object stay where it was put?",
        point_chart(
            [PLACES[place] for place in places],
            points,
            Axis("share of episodes whose objects all stay until the end", percent=True),
        ),
        "Apartments with a layout never seen in training. Unless named otherwise only drag slows rolling objects. "
        f"Filled: mean of {seeds}. Small open marks: each seed ({per_seed}). "
        "Bars: 95 % Student t intervals over the training seeds.",
    )


def _points(
    found: dict[tuple[str, str, str], Row], places: list[tuple[str, str]], number: int, strategy: str
) -> Points:
    at = [k for k, (task, world) in enumerate(places) if (task, strategy, world) in found]
    rows = [found[places[k][0], strategy, places[k][1]] for k in at]
    success = [row["stabilizing"] for row in rows]
    several = np.array([row["seeds"]["train"] > 1 for row in rows], dtype=bool)
    mean, lower, upper = (np.array([each[key] for each in success]) for key in ("mean", "lower", "upper"))
    lower, upper = (np.where(several, bound, np.nan) for bound in (lower, upper))
    members = [each["train_seeds"] for each in success]
    return Points(LABELS[strategy], at, mean, style(number), lower, upper, members)
