"""Marks drawn into a picture: the targets and their goals."""

from __future__ import annotations

from dataclasses import dataclass

from perdure.home.benchmark.episodes import Episode
from perdure.home.benchmark.tasks import AT
from perdure.home.sim.arrays import Vec3
from perdure.home.sim.objects import short_name

Color = tuple[float, float, float]

COLORS: tuple[Color, ...] = (
    (0.10, 0.42, 0.86),
    (0.86, 0.16, 0.46),
    (0.10, 0.60, 0.28),
    (0.93, 0.50, 0.08),
    (0.47, 0.30, 0.80),
)
"""One for each target, red, green and blue in [0, 1]."""


@dataclass(frozen=True)
class Mark:
    """A target and its goal: a pin over the object, a translucent ball at the goal, both in one color."""

    label: str
    """What the object is called in the picture."""
    goal: Vec3
    """Its goal position in the room in [m]."""
    color: Color
    number: int
    """Of the object in the scene; -1 when only the goal is to be seen."""
    radius: float = AT
    """Of the ball in [m]: inside it, the object counts as at its goal."""


def goal_marks(episode: Episode) -> tuple[Mark, ...]:
    """Return one mark for each target of an episode; the scene's first objects must be the targets."""
    return tuple(
        Mark(short_name(goal.kind), goal.position, COLORS[k % len(COLORS)], k) for k, goal in enumerate(episode.goals)
    )
