"""What was run: release strategy, world, planner and fallback, as logs and tables keep them, and the words for them.

Each is a column of its own. Nothing reads the words back. `comparison.describe` has what a release strategy does.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

from perdure.home.sim.scene import WorldOptions
from perdure.home.tasks.planners import FallbackName, PlannerName

WORLDS = {"drag": "drag only", "hull-apple": "apple a convex hull"}
"""Word of `WorldOptions.words` to what a reader sees; the others are read as they are, without hyphens."""
PLANNERS = {"open": "", "closed": "planned again after each skill"}
FALLBACKS = {"oracle": "", "none": "without fallback"}
"""Words of the closed loop; the open loop has no fallback."""


@dataclass(frozen=True, order=True)
class Strategy:
    """What was run. Other simulators may give `place` any text, such as "TP+SRL"."""

    place: str
    """Release strategy, see `read_release`."""
    world: str = ""
    """Options that differ from the usual world, in words: "drag only"."""
    planner: str = "open"
    fallback: str = "none"
    """Of the closed loop: "oracle" or "none"."""
    label: str = ""
    """What `perdure home analyze --names` calls the log files."""

    @property
    def name(self) -> str:
        """Its short name in tables: "ik, drag only, closed, without fallback"."""
        parts = [self.place, self.world]
        if self.planner != "open":
            parts += [self.planner, FALLBACKS.get(self.fallback, self.fallback)]
        return ", ".join(filter(None, [*parts, self.label]))

    @property
    def setting(self) -> str:
        """World, planner and fallback in words; "" where all are the usual ones."""
        parts = [self.world, PLANNERS.get(self.planner, self.planner)]
        if self.planner != "open":
            parts.append(FALLBACKS.get(self.fallback, self.fallback))
        return ", ".join(filter(None, parts))


COLUMNS = tuple(each.name for each in fields(Strategy))
"""Columns of tables that say what was run."""


def strategy_of(place: str, world: WorldOptions, planner: PlannerName, fallback: FallbackName) -> Strategy:
    """Return the strategy of a run from its options. With the open loop nothing falls back on the oracle."""
    words = ", ".join(WORLDS.get(word, word.replace("-", " ")) for word in world.words)
    return Strategy(place, words, planner, "none" if planner == "open" else fallback)
