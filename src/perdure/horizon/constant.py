"""The clock that stands still: there are always C steps to go."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from perdure.horizon.clock import Clock


@dataclass(frozen=True)
class Constant(Clock):
    """phi(0, C) (thesis, 3.3.3, choice 2).

    C = 0 says that nothing is left, which no policy was ever told while it acted in training.
    """

    name: ClassVar[str] = "constant"

    steps: float
    """C, the steps that are always left."""

    def time(self, elapsed: Any) -> tuple[Any, Any]:
        """(0, C)."""
        return 0 * elapsed, self.steps + 0 * elapsed
