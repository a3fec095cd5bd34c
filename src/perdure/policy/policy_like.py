"""Interface of policies: they act on rows of observations and describe themselves for the evaluation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from perdure.horizon import Clock
from perdure.policy.reference import Reference
from perdure.policy.task import TaskInfo

FloatArray = NDArray[np.float64]


class ActingLanes(Protocol):
    """The running lanes of one actor in a closed loop."""

    def act(self, observations: FloatArray, elapsed: int) -> FloatArray:
        """Return an action for each running lane.

        Args:
            observations: Shape (n, observation_size), one row for each running lane. Neither changed nor kept.
            elapsed: Steps since reset, the same for all.

        Returns:
            Shape (n, action_size).
        """

    def keep(self, rows: NDArray[np.bool_]) -> None:
        """Drop ended lanes: keep the rows where ``rows``, shape (n,), is true.

        It is called when lanes end, perhaps more than once before the next `act`.
        """


class PolicyLike(Protocol):
    """A policy of any origin. `Policy` is one, `FunctionPolicy` another."""

    @property
    def task(self) -> TaskInfo:
        """The task that it acts on."""

    @property
    def has_clock(self) -> bool:
        """Whether it has a time-to-go input, so that each of its lanes needs a clock."""

    @property
    def training_horizon(self) -> float:
        """The longest horizon it was trained for, in steps; inf if training had none."""

    @property
    def provenance(self) -> Mapping[str, Any]:
        """Its origin: "method" and "seed" among others."""

    @property
    def reference(self) -> Reference | None:
        """Its episodes within its training horizon; None if they were not measured."""

    @property
    def observation_std(self) -> FloatArray:
        """Standard deviation of each observation component in training, shape (observation_size,)."""

    def start(self, clocks: Sequence[Clock | None]) -> ActingLanes:
        """Begin episodes, one for each clock; a clock is None exactly if there is no time-to-go input."""
