"""Linear embedding: the share of the episode that is left."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from perdure.horizon.embedding import Embedding


@dataclass(frozen=True)
class Linear(Embedding):
    """phi(t, T) = 1 - t/T (Pardo et al., Time limits in reinforcement learning, 2018).

    0 when nothing is left (t >= T, also T = 0), 1 for an infinite horizon. With random horizons the value does
    not determine how many steps are left. Under a constant clock it is 1 for every C > 0.
    """

    name: ClassVar[str] = "linear"

    @property
    def size(self) -> int:
        """Return 1."""
        return 1

    def __call__(self, elapsed: Any, horizon: Any) -> Any:
        """Return phi(t, T), shape (*batch, 1)."""
        left = horizon > elapsed
        # If no steps are left, T + 1 avoids 0/0 and `left` makes the result 0. Operators only, for traced arrays.
        share = (1.0 - elapsed / (horizon + (1.0 - left))) * left
        return share[..., None] if hasattr(share, "ndim") else np.asarray(share)[..., None]
