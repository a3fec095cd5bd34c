"""Constant clock: C steps to go at every step."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from perdure.horizon.clock import Clock


@dataclass(frozen=True)
class Constant(Clock):
    """phi(0, C) (thesis, 3.3.3, choice 2).

    C = 0 (no steps left) is out of distribution.
    """

    name: ClassVar[str] = "constant"

    steps: float
    """C, the steps to go at every step."""

    def time(self, elapsed: Any) -> tuple[Any, Any]:
        """Return (0, C)."""
        return 0 * elapsed, self.steps + 0 * elapsed
