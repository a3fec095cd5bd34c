"""The facts about the world that tasks depend on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from perdure.home.errors import HomeError
from perdure.home.sim.arrays import FloatArray, IntArray

NOTHING = -1
"""`held` when the gripper holds nothing."""
SOMETHING_ELSE = -2
"""`held` when the gripper holds clutter or a handle."""


@dataclass(frozen=True)
class WorldFacts:
    """The state of a task in one world, or in many: the leading axes `*` may be lanes, steps, both or nothing."""

    object_positions: FloatArray
    """Middles of the target objects in the room in [m]. Shape (*, targets, 3)."""
    goal_positions: FloatArray
    """Where they belong in [m]. Shape (*, targets, 3) or (targets, 3)."""
    held: IntArray
    """Number of the target in the gripper, or NOTHING, or SOMETHING_ELSE. Shape (*)."""
    drawer: FloatArray
    """How far the drawer of target 0 is out in [m] (0 where the task has none). Shape (*)."""
    fridge: FloatArray
    """How far the fridge's upper door is open in [rad]. Shape (*)."""

    def __post_init__(self) -> None:
        """Raise HomeError for shapes that do not match."""
        lead = np.shape(self.held)
        targets = np.shape(self.object_positions)[-2:]
        sizes = {
            "object_positions": (np.shape(self.object_positions), lead + targets),
            "drawer": (np.shape(self.drawer), lead),
            "fridge": (np.shape(self.fridge), lead),
        }
        for name, (found, wanted) in sizes.items():
            if found != wanted:
                raise HomeError(f"{name} has shape {found}; with held of shape {lead} it must be {wanted}")
        if targets[-1:] != (3,) or np.shape(self.goal_positions) not in (targets, lead + targets):
            raise HomeError(
                f"goal_positions has shape {np.shape(self.goal_positions)}; it must be {targets} or {lead + targets}"
            )

    @property
    def targets(self) -> int:
        """Number of target objects."""
        return int(np.shape(self.object_positions)[-2])

    def __getitem__(self, index: int | slice) -> WorldFacts:
        """The facts at one index (or a slice) of the first leading axis."""
        per_lane = np.ndim(self.goal_positions) == np.ndim(self.object_positions)
        return WorldFacts(
            self.object_positions[index],
            self.goal_positions[index] if per_lane and np.ndim(self.held) else self.goal_positions,
            self.held[index],
            self.drawer[index],
            self.fridge[index],
        )

    def __len__(self) -> int:
        """Length of the first leading axis."""
        return len(self.held)
