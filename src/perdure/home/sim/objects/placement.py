"""The pose of an object on a receptacle."""

from __future__ import annotations

import math
from dataclasses import dataclass

from perdure.home.errors import HomeError
from perdure.home.sim.arrays import Quaternion, Vec3


@dataclass(frozen=True)
class Placement:
    """An object at rest on a receptacle."""

    kind: str
    """YCB name, such as `024_bowl`."""
    position: Vec3
    """Of the object's frame in the room in [m]."""
    quaternion: Quaternion
    """(w, x, y, z), from the object's frame to the room."""
    receptacle: str
    """Unique name `piece|receptacle` in the apartment."""

    def __post_init__(self) -> None:
        """Raise HomeError for numbers that are not finite and for quaternions that are no rotation."""
        if not all(map(math.isfinite, (*self.position, *self.quaternion))):
            raise HomeError(f"pose of {self.kind} must be finite, not {self.position}, {self.quaternion}")
        if abs(math.hypot(*self.quaternion) - 1.0) > 1e-3:
            raise HomeError(f"quaternion of {self.kind} must have length 1, not {self.quaternion}")
