"""Episodes that only the task can end."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar

from perdure.horizon.distribution import HorizonDistribution


@dataclass(frozen=True)
class Infinite(HorizonDistribution):
    """T is infinite."""

    name: ClassVar[str] = "infinite"

    @property
    def longest(self) -> float:
        """Infinity."""
        return math.inf

    def from_uniform(self, u: Any) -> Any:
        """Infinity for every entry."""
        return math.inf + 0.0 * u
