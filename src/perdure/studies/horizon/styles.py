"""Color, dash and shape of each method, the same in every figure."""

from __future__ import annotations

from dataclasses import replace

from perdure.report import theme
from perdure.report.theme import Style
from perdure.studies.horizon.claim import Condition

ORDER = (
    "ppo",
    "ppo-undiscounted",
    "geometric",
    "linear",
    "ppo-average-reward",
    "random-horizon",
    "geometric-fixed",
    "ppo-short",
)
"""Methods to the styles of the theme; others share the last one's color."""
SIBLINGS = {"linear-random": "linear", "linear-10-workers": "linear"}
"""Methods of one color, told apart by shape and dash."""


def style(condition: Condition) -> Style:
    """Return the style of a method; the optimistic choice of C has another shape and dash than the other clocks."""
    name = SIBLINGS.get(condition.method, condition.method)
    place = ORDER.index(name) if name in ORDER else len(ORDER) - 1
    found = theme.style(place)
    if name != condition.method or condition.clock == "best":
        other = theme.style(place + 4)
        return replace(found, dash=other.dash, shape=other.shape)
    return found
