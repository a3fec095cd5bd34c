"""The abstract idea of an embedding phi(t, T) of the time-to-go."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, ClassVar

from perdure.horizon.registry import to_json


class Embedding(ABC):
    """Maps elapsed steps t and a horizon T to the vector appended to the observation.

    Subclasses are frozen dataclasses. They use array operators only, so one body serves Python numbers, NumPy arrays and
    traced JAX arrays. More elapsed steps than the horizon count as nothing left.
    """

    name: ClassVar[str]
    """How files and command lines call it."""

    @property
    @abstractmethod
    def size(self) -> int:
        """Length of the vector."""

    @abstractmethod
    def __call__(self, elapsed: Any, horizon: Any) -> Any:
        """phi(elapsed, horizon), of shape (*batch, size), for two arrays of shape (*batch,); T may be infinite."""

    def to_json(self) -> dict[str, Any]:
        """The embedding as plain JSON values."""
        return to_json(self)
