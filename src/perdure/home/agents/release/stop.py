"""`stop`: halt, then release. The control that shows how much of a hand-over's gain comes from halting."""

from __future__ import annotations

from dataclasses import dataclass

from perdure.home.agents.release.hand_over import HandOver, Held, Motion, stop


@dataclass
class Stop(HandOver):
    """The base returns to its pose of the freeze; when the hand is at rest it opens."""

    name = "stop"

    def motion(self, held: Held) -> Motion:
        """See `HandOver.motion`."""
        yield from stop(held)
