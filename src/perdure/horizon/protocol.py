"""Horizon protocol: how training treats time, in one record that is stored with the policy."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any, Literal, Self, get_args

from perdure.horizon.distribution import HorizonDistribution, distribution_from_json
from perdure.horizon.embedding import Embedding, embedding_from_json
from perdure.horizon.errors import HorizonError

End = Literal["terminated", "truncated"]


@dataclass(frozen=True)
class HorizonProtocol:
    """How training treats time: time-to-go input, length of episodes, meaning of their end, discounts.

    gamma = 1 with ``end="truncated"`` is legal, but then values are determined only up to a constant if the task never
    terminates, and V may drift. The same holds for gamma = 1 with an infinite horizon.

    Raises:
        HorizonError: If the parts contradict each other.
    """

    embedding: Embedding | None
    """phi; None if the agent does not observe time."""
    horizon: HorizonDistribution
    """Distribution of the training horizon T."""
    end: End
    """How reaching T counts: ``terminated`` (no value follows) or ``truncated`` (the task continues: bootstrap from the
    last observation)."""
    gamma: float
    """Discount of the objective, in [0, 1]."""
    normalizer_gamma: float
    """Discount of the running return whose standard deviation divides the rewards (VecNormalize's gamma), in [0, 1]."""
    normalize_embedding: bool = False
    """Whether phi passes the observation normalizer, as with VecNormalize in Stable-Baselines3. Off by default, because
    a normalized phi has different meanings in training and at deployment."""

    def __post_init__(self) -> None:
        """Refuse contradictions."""
        if not (self.embedding is None or isinstance(self.embedding, Embedding)):
            raise HorizonError(
                f"embedding must be an Embedding, such as Geometric(10), or None, got {self.embedding!r}"
            )
        if not isinstance(self.horizon, HorizonDistribution):
            raise HorizonError(f"horizon must be a HorizonDistribution, such as Fixed(1000), got {self.horizon!r}")
        check_end(self.end)
        for name in ("gamma", "normalizer_gamma"):
            value = getattr(self, name)
            if not (isinstance(value, int | float) and 0 <= value <= 1):
                raise HorizonError(f"{name} must be a number in [0, 1], got {value!r}")
        if not isinstance(self.normalize_embedding, bool):
            raise HorizonError(f"normalize_embedding must be True or False, got {self.normalize_embedding!r}")
        if self.normalize_embedding and self.embedding is None:
            raise HorizonError("normalize_embedding needs an embedding, and this protocol has none")

    @property
    def embedding_size(self) -> int:
        """Return the number of components appended to the observation; 0 without phi."""
        return 0 if self.embedding is None else self.embedding.size

    def embed(self, elapsed: Any, horizon: Any) -> Any:
        """Return phi, of shape (n, embedding_size), (n, 0) without an embedding.

        Args:
            elapsed: Steps since reset, NumPy or JAX, shape (n,).
            horizon: T, NumPy or JAX, shape (n,); may be infinite.
        """
        if self.embedding is None:
            return (0.0 * elapsed)[..., None][..., :0]
        return self.embedding(elapsed, horizon)

    def to_json(self) -> dict[str, Any]:
        """Return the protocol as plain JSON values."""
        return {
            "embedding": None if self.embedding is None else self.embedding.to_json(),
            "horizon": self.horizon.to_json(),
            "end": self.end,
            "gamma": self.gamma,
            "normalizer_gamma": self.normalizer_gamma,
            "normalize_embedding": self.normalize_embedding,
        }

    @classmethod
    def from_json(cls, values: dict[str, Any]) -> Self:
        """Return the protocol that :meth:`to_json` described.

        Args:
            values: One entry for every field.

        Raises:
            HorizonError: If a part is missing, unknown or out of range.
        """
        if not isinstance(values, dict):
            raise HorizonError(f"a horizon protocol is a table of fields, got {values!r}")
        names, given = {field.name for field in fields(cls)}, set(values)
        if given != names:
            listing = "; ".join(
                f"{word} {', '.join(sorted(some))}"
                for word, some in (("missing", names - given), ("unknown", given - names))
                if some
            )
            raise HorizonError(f"a horizon protocol cannot be read: {listing}")
        embedding = None if values["embedding"] is None else embedding_from_json(values["embedding"])
        return cls(**{**values, "embedding": embedding, "horizon": distribution_from_json(values["horizon"])})


def check_end(end: Any) -> None:
    """Refuse an unknown meaning of a horizon's end.

    Args:
        end: ``"terminated"`` or ``"truncated"``.

    Raises:
        HorizonError: If it is anything else.
    """
    if end not in get_args(End):
        raise HorizonError(f"end must be one of {', '.join(get_args(End))}, got {end!r}")
