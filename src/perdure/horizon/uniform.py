"""Uniformly random horizon: the domain randomization of the thesis."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from perdure.horizon.distribution import HorizonDistribution, check_steps
from perdure.horizon.errors import HorizonError


@dataclass(frozen=True)
class Uniform(HorizonDistribution):
    """T is a whole number drawn uniformly from {low, ..., high} (thesis, 3.3.2)."""

    name: ClassVar[str] = "uniform"

    low: int = 200
    """T_min."""
    high: int = 1000
    """T_max."""

    def __post_init__(self) -> None:
        """Refuse an empty range."""
        check_steps("the shortest horizon", self.low)
        check_steps("the longest horizon", self.high)
        if self.low > self.high:
            raise HorizonError(f"the shortest horizon ({self.low}) must not exceed the longest ({self.high})")

    @property
    def longest(self) -> float:
        """T_max."""
        return float(self.high)

    def from_uniform(self, u: Any) -> Any:
        """Return T = low + floor(u * (high - low + 1))."""
        return self.low + (u * (self.high - self.low + 1)) // 1
