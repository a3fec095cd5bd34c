"""Time feature of sb3-contrib: steps left, in units of the training horizon."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from perdure.horizon.distribution import check_steps
from perdure.horizon.embedding import Embedding


@dataclass(frozen=True)
class TimeFeature(Embedding):
    """phi(t, T) = min(1, (T - t) / N) with N training steps: what sb3-contrib's `TimeFeatureWrapper` appends.

    The wrapper computes 1 - t/N, which is negative after N steps, and so is phi. `Linear` stays at 0 instead.
    phi under each clock:

    | clock | phi | the same as |
    |---|---|---|
    | `countdown:N` | 1 - t/N, below 0 after N steps | the wrapper |
    | `constant:N` | 1 | the wrapper with `test_mode=True` |
    | `constant:C` | C/N, at most 1 | the wrapper with constant t |
    | `periodic:N` | 1 - (t mod N)/N | the wrapper, reset every N steps |
    | `countdown:C`, C > N | 1 until N steps are left, then down | - |

    The upper limit is 1 because at most N steps were left in training. An infinite T also gives 1.
    """

    name: ClassVar[str] = "time_feature"

    steps: int = 1000
    """N, the steps of a training episode (`max_steps`)."""

    def __post_init__(self) -> None:
        """Refuse an invalid number of steps."""
        check_steps("the steps of a time feature", self.steps)

    @property
    def size(self) -> int:
        """Return 1."""
        return 1

    def __call__(self, elapsed: Any, horizon: Any) -> Any:
        """Return phi(t, T), shape (*batch, 1)."""
        # N - (T - t) is t where T = N, so that the quotient is the wrapper's to the last bit.
        share = 1.0 - (self.steps - (horizon - elapsed)) / self.steps
        # A method, not a function of NumPy: t and T may be traced JAX arrays.
        return (share if hasattr(share, "ndim") else np.asarray(share)).clip(max=1.0)[..., None]
