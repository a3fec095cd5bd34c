"""Result of a rule that chooses C without a sweep."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from perdure.horizon import Constant


@dataclass(frozen=True)
class RuleChoice:
    """One policy's clock."""

    rule: str
    clock: Constant
    scores: Mapping[Constant, float]
    """Last score of each candidate."""
    lane_steps: int
    """Steps of simulation it took."""
