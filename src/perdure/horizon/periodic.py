"""Periodic clock: count down from C steps and restart, without end."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from perdure.horizon.clock import Clock


@dataclass(frozen=True)
class Periodic(Clock):
    """phi(t mod C, C) (thesis, 3.3.3, choice 3). Periodic(0) means Constant(0)."""

    name: ClassVar[str] = "periodic"

    steps: float
    """C, the period."""

    def time(self, elapsed: Any) -> tuple[Any, Any]:
        """Return (t mod C, C)."""
        if self.steps == 0:
            return 0 * elapsed, 0 * elapsed
        return elapsed % self.steps, self.steps + 0 * elapsed
