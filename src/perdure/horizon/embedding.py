"""Base class of embeddings phi(t, T) of the time-to-go."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any

from perdure.horizon.registered import Registered, from_json


class Embedding(Registered):
    """Map elapsed steps t and a horizon T to the vector appended to the observation.

    Subclasses are frozen dataclasses. They use array operators only, so one body serves Python numbers, NumPy arrays
    and traced JAX arrays. If t > T, no steps are left.
    """

    @property
    @abstractmethod
    def size(self) -> int:
        """Return the length of the vector."""

    @abstractmethod
    def __call__(self, elapsed: Any, horizon: Any) -> Any:
        """Return phi(t, T), of shape (*batch, size).

        Args:
            elapsed: t, steps since reset, shape (*batch,).
            horizon: T, steps the episode may last, shape (*batch,); may be infinite.
        """


def embedding_from_json(values: Any) -> Embedding:
    """Return the embedding that its `to_json` described.

    Args:
        values: ``{"name": ..., field: value, ...}``.

    Raises:
        HorizonError: If there is no such embedding or a field is unknown or out of range.
    """
    return from_json(Embedding, values)  # type: ignore[type-abstract]
