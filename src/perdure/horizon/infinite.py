"""Infinite horizon: only the task ends an episode."""

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
        """Return infinity."""
        return math.inf

    def from_uniform(self, u: Any) -> Any:
        """Return infinity for every entry."""
        return math.inf + 0.0 * u
