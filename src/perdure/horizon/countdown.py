"""The clock of training, carried on: it counts down to the end of the deployment."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from perdure.horizon.clock import Clock


@dataclass(frozen=True)
class Countdown(Clock):
    """phi(t, T_test) (thesis, 3.3.3, choice 1). Needs to know when the deployment ends."""

    name: ClassVar[str] = "countdown"

    steps: float
    """T_test, the steps of the deployment."""

    def time(self, elapsed: Any) -> tuple[Any, Any]:
        """(t, T_test)."""
        return elapsed, self.steps + 0 * elapsed
