"""Squash the network's output into the action box by tanh, instead of clipping it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from perdure.policy.errors import PolicyError


@dataclass(frozen=True)
class TanhSquash:
    """low + (tanh(output) + 1) / 2 * (high - low), as SAC, TQC and TD3 of Stable-Baselines3 act.

    Raises:
        PolicyError: If the limit is not positive.
    """

    limit: float = math.inf
    """The output is cut to +-limit before tanh; Stable-Baselines3's `clip_mean` (SAC and TQC with `use_sde`)."""

    def __post_init__(self) -> None:
        """Refuse a limit that is no positive number."""
        if not (isinstance(self.limit, int | float) and self.limit > 0):
            raise PolicyError(f"the limit of a squashed output must be a positive number, got {self.limit!r}")

    def __call__(
        self, outputs: NDArray[np.float32], low: NDArray[np.float64], high: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return actions of shape (n, action_size) within the box, from outputs of that shape.

        The arithmetic is of 32 bits, in the order of Stable-Baselines3's `unscale_action`.
        """
        limit, one, half = np.float32(self.limit), np.float32(1), np.float32(0.5)
        scaled = np.tanh(np.minimum(np.maximum(outputs, -limit), limit))
        low32, high32 = low.astype(np.float32), high.astype(np.float32)
        return (low32 + half * (scaled + one) * (high32 - low32)).astype(np.float64)

    def to_json(self) -> dict[str, Any]:
        """Return the squashing as plain JSON values."""
        return {"name": "tanh", "limit": None if math.isinf(self.limit) else float(self.limit)}

    @classmethod
    def from_json(cls, values: Any) -> Self:
        """Return the squashing that :meth:`to_json` described.

        Raises:
            PolicyError: If the values describe none.
        """
        if not isinstance(values, dict) or set(values) != {"name", "limit"} or values["name"] != "tanh":
            raise PolicyError('a squashing is written {"name": "tanh", "limit": a positive number or null}')
        return cls(math.inf if values["limit"] is None else values["limit"])
