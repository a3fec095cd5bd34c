"""What a policy was made for."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class TaskInfo:
    """What the policy was trained on, so that it is not run on something else unnoticed."""

    name: str
    observation_size: int
    action_low: tuple[float, ...]
    action_high: tuple[float, ...]
    discrete_actions: bool = False
    """Whether each action component is a whole number from its lowest to its highest."""

    @property
    def action_size(self) -> int:
        """Length of one action."""
        return len(self.action_low)
