"""Placement of objects on receptacles: uniform, upright, not overlapping, within the robot's reach."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from perdure.home.sim.apartments import Apartment, FreeSpace, Receptacle, plane
from perdure.home.sim.arrays import FloatArray, Vec3
from perdure.home.sim.objects import Placement

TRIES = 50
"""Places tried for one object on one receptacle (habitat-lab, `samplers/object_sampler.py`)."""
NAVIGABLE_WITHIN = 1.5
"""Largest horizontal distance in [m] from an object or goal to where the robot can stand (`nav_to_min_distance`)."""
GAP = 0.005
"""Smallest gap between two objects on a receptacle in [m] (OURS)."""
LIFT = 0.001
"""Height above the surface at which an object is put before it settles in [m] (OURS)."""


class ObjectModels(Protocol):
    """What the generator needs of the objects. An object's frame: z up when it stands upright."""

    def box(self, kind: str) -> tuple[Vec3, Vec3]:
        """Return lower and upper corner of an upright object's bounding box in its own frame, in [m]."""

    def add(self, spec: Any, kind: str, name: str, position: Vec3, quaternion: tuple[float, ...]) -> None:
        """Add the object as a free body `name` to a MuJoCo specification, its frame at a pose (w, x, y, z)."""


@dataclass
class Surfaces:
    """Objects placed on receptacles so far: footprints (x, y, half x, half y, yaw) by the receptacle's unique name."""

    apartment: Apartment
    space: FreeSpace
    models: ObjectModels
    taken: dict[str, list[FloatArray]] = field(default_factory=dict)

    def footprint(self, kind: str, x: float, y: float, yaw: float) -> FloatArray:
        """Return the rectangle an upright object covers in the room. Shape (5,)."""
        low, high = (np.array(corner) for corner in self.models.box(kind))
        middle, half = 0.5 * (low + high), 0.5 * (high - low)
        cos, sin = math.cos(yaw), math.sin(yaw)
        center = (x + cos * middle[0] - sin * middle[1], y + sin * middle[0] + cos * middle[1])
        return np.array([*center, half[0], half[1], yaw])

    def add(self, placement: Placement) -> None:
        """Add an object to its receptacle."""
        w, _, _, z = placement.quaternion
        shape = self.footprint(placement.kind, *placement.position[:2], 2.0 * math.atan2(z, w))
        self.taken.setdefault(placement.receptacle, []).append(shape)

    def draw(
        self,
        kind: str,
        receptacle: Receptacle,
        rng: np.random.Generator,
        ratio: Mapping[str, float],
        lift: float = LIFT,
        anywhere: bool = False,
    ) -> Placement | None:
        """Return a place for an upright object, uniform on a receptacle, None when none was found in 50 tries.

        Args:
            kind: YCB name.
            receptacle: Where to put it.
            rng: The random generator.
            ratio: Share of the receptacle's length and width to use, by receptacle name.
            lift: Distance of its lowest point from the surface in [m].
            anywhere: Whether the robot need not be able to stand near it.
        """
        low, high = self.models.box(kind)
        if high[2] - low[2] + lift >= receptacle.headroom:
            return None
        share = ratio.get(receptacle.name, 1.0)
        for _ in range(TRIES):
            across, along, turn = rng.random(3)
            offset = share * np.array([2.0 * across - 1.0, 2.0 * along - 1.0]) * receptacle.half
            yaw = 2.0 * math.pi * turn
            x, y, height = self.apartment.surface_to_room(receptacle, offset)
            shape = self.footprint(kind, float(x), float(y), yaw)
            if self._is_taken(shape, receptacle) or not (anywhere or self._is_near(x, y)):
                continue
            position = (round(float(x), 4), round(float(y), 4), round(float(height) - low[2] + lift, 4))
            quaternion = (round(math.cos(yaw / 2), 5), 0.0, 0.0, round(math.sin(yaw / 2), 5))
            return Placement(kind, position, quaternion, receptacle.unique_name)
        return None

    def _is_taken(self, shape: FloatArray, receptacle: Receptacle) -> bool:
        others = self.taken.get(receptacle.unique_name, [])
        return bool(others) and bool(plane.overlap(shape[None], np.stack(others), GAP).any())

    def _is_near(self, x: float, y: float) -> bool:
        return bool(self.space.nearest(np.array([[x, y]]))[1][0] < NAVIGABLE_WITHIN)
