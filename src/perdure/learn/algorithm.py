"""What a training run asks of a learning algorithm. `PPO` is one; `run.py` and `checkpoint.py` know no other detail."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from perdure.envs.traced import WorldSlot
    from perdure.policy import Policy


class Metrics(NamedTuple):
    """What one iteration reports for the learning curves."""

    episodes: NDArray[np.float64]
    """A row (step, return, length) for each training episode that ended, shape (episodes, 3)."""
    diagnostics: dict[str, float]
    """The algorithm's own numbers, such as its losses."""


class Algorithm(Protocol):
    """Learns one task under one configuration. `state` is a tree of arrays, which is all that a checkpoint stores."""

    @property
    def diagnostics(self) -> tuple[str, ...]:
        """Names of `Metrics.diagnostics`, in their order."""

    def init(self, seed: int) -> Any:
        """Return the state before training."""

    def start(self, state: Any, slot: WorldSlot, observations: Any, *, seed: int, segment: int) -> tuple[Any, Any]:
        """Begin a segment: return the state and the running environments, which were reset to `observations`."""

    def iterate(self, state: Any, running: Any, *, seed: int, iteration: int) -> tuple[Any, Any, Metrics]:
        """Learn for one iteration; return both after it. The memory of `state` may be reused."""

    def observation_std(self, state: Any) -> NDArray[np.float64]:
        """Return the spread of each observation component in training so far, shape (observation_size,)."""

    def policy(self, state: Any) -> Policy:
        """Return the policy learned so far, without provenance and reference."""
