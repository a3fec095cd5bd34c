"""What was run: release strategy, world, planner and fallback, as logs and tables keep them, and the words for them.

Each is a column of its own. `place`, `planner` and `fallback` are names, as the command line has them. `world` holds
words, which nothing parses. `comparison.describe` has what a release strategy does.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

from perdure.home.sim.scene import WorldOptions
from perdure.home.tasks.planners import FallbackName, OpenLoop, Planner, find_planner

CALM = "none"
"""Name of no disturbance at all."""
WORLDS = {"drag": "drag only", "hull-apple": "apple a convex hull"}
"""Word of `WorldOptions.words` to what a reader sees; the others are read as they are, without hyphens."""
FALLBACKS = {"oracle": "", "none": "without fallback"}
"""Words of planners that have a fallback."""


@dataclass(frozen=True, order=True)
class Strategy:
    """What was run. Other simulators may give `place` any text, such as "TP+SRL"."""

    place: str
    """Release strategy, see `read_release`."""
    world: str = ""
    """Options that differ from the usual world, in words: "drag only"."""
    planner: str = OpenLoop.name
    """A name of `Planner`, or another simulator's."""
    fallback: str = "none"
    """"oracle" or "none"; "none" for planners that have no fallback."""
    disturbance: str = CALM
    """Disturbances that act together, "bump:0.1 perception:0.02", or "none"."""
    label: str = ""
    """What `perdure home analyze --names` calls the log files."""

    @property
    def name(self) -> str:
        """Its short name in tables: "ik, drag only, closed, without fallback"."""
        parts = [self.place, self.world]
        if self.planner != OpenLoop.name:
            parts += [self.planner, FALLBACKS.get(self.fallback, self.fallback)]
        return ", ".join(filter(None, [*parts, self._disturbed, self.label]))

    @property
    def setting(self) -> str:
        """World, planner, fallback and disturbance in words; "" where all are the usual ones."""
        parts = [self.world]
        if self.planner != OpenLoop.name:
            kind = Planner.kinds().get(self.planner)
            parts.append(self.planner if kind is None else kind.words)
            parts.append(FALLBACKS.get(self.fallback, self.fallback))
        return ", ".join(filter(None, [*parts, self._disturbed]))

    @property
    def _disturbed(self) -> str:
        return "" if self.disturbance == CALM else self.disturbance


COLUMNS = tuple(each.name for each in fields(Strategy))
"""Columns of tables that say what was run."""


def strategy_of(
    place: str, world: WorldOptions, planner: str, fallback: FallbackName, disturbance: str = CALM
) -> Strategy:
    """Return the strategy of a run from its options; PerdureError if there is no such planner."""
    words = ", ".join(WORLDS.get(word, word.replace("-", " ")) for word in world.words)
    return Strategy(place, words, planner, fallback if find_planner(planner).has_fallback else "none", disturbance)
