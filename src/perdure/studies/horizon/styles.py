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
"""Methods in the order of the theme's styles; others share the last one's."""
SIBLINGS = {"linear-random": "linear", "linear-10-workers": "linear"}
"""Methods of one color, told apart by shape and dash."""


def style(condition: Condition, variant: int = 0) -> Style:
    """Return the style of a method.

    Args:
        condition: The method; the optimistic choice of C is a variant of its own.
        variant: Of the same color, with another dash and shape.
    """
    name = SIBLINGS.get(condition.method, condition.method)
    place = ORDER.index(name) if name in ORDER else len(ORDER) - 1
    variant += name != condition.method or condition.clock == "best"
    other = theme.style(place + 3 + variant if variant else place)
    return replace(theme.style(place), dash=other.dash, shape=other.shape)
