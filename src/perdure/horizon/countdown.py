"""Count down to the end of the deployment, as in training."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from perdure.horizon.clock import Clock


@dataclass(frozen=True)
class Countdown(Clock):
    """phi(t, T_test) (thesis, 3.3.3, choice 1). The length of the deployment must be known."""

    name: ClassVar[str] = "countdown"

    steps: float
    """T_test, the steps of the deployment."""

    def time(self, elapsed: Any) -> tuple[Any, Any]:
        """Return (t, T_test)."""
        return elapsed, self.steps + 0 * elapsed
