"""Description of the task that a policy was trained on."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class TaskInfo:
    """The task that a policy was trained on, for checks that a world fits the policy."""

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
