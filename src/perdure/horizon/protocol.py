"""How time is treated, in one record that the learner obeys, the policy file keeps and the clocks read."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, Self, get_args

from perdure.horizon.embedding import Embedding
from perdure.horizon.errors import HorizonError
from perdure.horizon.law import HorizonLaw
from perdure.horizon.registry import from_json

End = Literal["terminated", "truncated"]


@dataclass(frozen=True)
class HorizonProtocol:
    """What an agent knows about time, how long its episodes last, and what their end means.

    gamma = 1 with ``end="truncated"`` is legal but leaves the value function without an anchor: V + c solves the same
    equations for every constant c, so V may drift.

    Raises:
        HorizonError: If the parts contradict each other.
    """

    embedding: Embedding | None
    """phi; None if the agent is not told the time."""
    horizon: HorizonLaw
    """Law of the training horizon T."""
    end: End
    """What reaching T means: ``terminated`` (nothing follows, a time-aware agent) or ``truncated`` (the world goes on:
    bootstrap the value of the last observation)."""
    gamma: float
    """Discount of the objective, in [0, 1]."""
    normalizer_gamma: float
    """Discount of the running return whose spread scales the rewards, in [0, 1]. A setting of its own: with gamma = 1 it
    decides how large the rewards look to the value network."""
    normalize_embedding: bool = False
    """Replication switch: phi passes the observation normaliser, as Stable-Baselines3 with VecNormalize would have it.
    Off, because a normalised phi means something else in training and in deployment."""

    def __post_init__(self) -> None:
        """Refuse contradictions."""
        for name in ("gamma", "normalizer_gamma"):
            if not 0 <= getattr(self, name) <= 1:
                raise HorizonError(f"{name} must lie in [0, 1], got {getattr(self, name)}")
        if self.end not in get_args(End):
            raise HorizonError(f"end must be one of {', '.join(get_args(End))}, got {self.end!r}")
        if self.normalize_embedding and self.embedding is None:
            raise HorizonError("normalize_embedding needs an embedding, and this protocol has none")

    @property
    def embedding_size(self) -> int:
        """Numbers appended to the observation; 0 without phi."""
        return 0 if self.embedding is None else self.embedding.size

    def embed(self, elapsed: Any, horizon: Any) -> Any:
        """phi of shape (n, embedding_size) for NumPy or JAX arrays of shape (n,); (n, 0) without an embedding."""
        if self.embedding is None:
            return (0.0 * elapsed)[..., None][..., :0]
        return self.embedding(elapsed, horizon)

    def to_json(self) -> dict[str, Any]:
        """The protocol as plain JSON values."""
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
        """The protocol that :meth:`to_json` described.

        Raises:
            HorizonError: If a part is missing, unknown or out of range.
        """
        try:
            parts = dict(values)
            embedding, horizon = parts.pop("embedding"), parts.pop("horizon")
            return cls(
                embedding=None if embedding is None else from_json(Embedding, embedding),  # type: ignore[type-abstract]
                horizon=from_json(HorizonLaw, horizon),  # type: ignore[type-abstract]
                **parts,
            )
        except (KeyError, TypeError) as error:
            raise HorizonError(f"a horizon protocol cannot be read from {values}: {error}") from None
