"""What the generator must know about objects, and where it gets it from."""

from __future__ import annotations

from typing import Any, Protocol

Vec3 = tuple[float, float, float]


class ObjectModels(Protocol):
    """The objects of the benchmark, as far as episodes need them. An object's frame: z up when it stands upright."""

    def box(self, kind: str) -> tuple[Vec3, Vec3]:
        """Lower and upper corner of an upright object's bounding box in its own frame, in [m]."""

    def add(self, spec: Any, kind: str, name: str, position: Vec3, quaternion: tuple[float, ...]) -> None:
        """Adds the object as a free body `name` to a MuJoCo specification, its frame at a pose (w, x, y, z)."""
