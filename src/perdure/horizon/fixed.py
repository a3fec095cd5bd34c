"""Fixed horizon: the same for every episode."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from perdure.horizon.distribution import HorizonDistribution, check_steps


@dataclass(frozen=True)
class Fixed(HorizonDistribution):
    """T is always ``steps``."""

    name: ClassVar[str] = "fixed"

    steps: int = 1000
    """T."""

    def __post_init__(self) -> None:
        """Refuse an invalid number of steps."""
        check_steps("a fixed horizon", self.steps)

    @property
    def longest(self) -> float:
        """T."""
        return float(self.steps)

    def from_uniform(self, u: Any) -> Any:
        """Return T for every entry."""
        return self.steps + 0.0 * u
