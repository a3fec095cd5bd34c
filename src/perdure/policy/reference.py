"""Episodes of a policy within its training horizon: the baseline of the hold score.

At its end, training records them in the policy file. For other policies, the first evaluation records them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from perdure.policy.errors import PolicyError

BIN_STEPS = 10
"""Steps whose rewards are stored as one sum."""


@dataclass(frozen=True, eq=False)
class Reference:
    """Episodes of a deterministic policy under the conditions it was trained in: horizon T and a countdown to it.

    Raises:
        PolicyError: If the arrays do not fit together.
    """

    horizon: int
    """T: steps an episode may last."""
    rewards: NDArray[np.float64]
    """Reward sums of BIN_STEPS steps each, shape (episodes, ceil(horizon / BIN_STEPS)); 0 after an episode's end."""
    lengths: NDArray[np.int64]
    """Steps of each episode, the last one included, shape (episodes,)."""
    terminated: NDArray[np.bool_]
    """Whether the task ended the episode (a fall), shape (episodes,)."""
    observation_low: NDArray[np.float64]
    """Smallest value of each component of the observation, shape (observation_size,)."""
    observation_high: NDArray[np.float64]
    """Largest value of each component of the observation, shape (observation_size,)."""

    def __post_init__(self) -> None:
        """Refuse arrays that do not fit together."""
        episodes, bins = self.lengths.size, math.ceil(self.horizon / BIN_STEPS)
        low, high = self.observation_low, self.observation_high
        fits = (
            self.horizon >= 1
            and episodes >= 1
            and self.rewards.shape == (episodes, bins)
            and self.terminated.shape == self.lengths.shape == (episodes,)
            and low.ndim == 1
            and low.shape == high.shape
        )
        if not fits or self.lengths.min() < 1 or self.lengths.max() > self.horizon:
            raise PolicyError(f"the reference episodes over {self.horizon} steps do not fit together")
        finite = all(np.isfinite(each).all() for each in (self.rewards, low, high))
        if not finite or not (low <= high).all():
            raise PolicyError("the reference episodes hold numbers that are not finite or an empty observation range")

    @property
    def returns(self) -> NDArray[np.float64]:
        """Undiscounted return of each episode, shape (episodes,)."""
        total: NDArray[np.float64] = self.rewards.sum(axis=1)
        return total

    @property
    def rate(self) -> float:
        """Mean reward of a step that was made, over all episodes."""
        return float(self.rewards.sum() / self.lengths.sum())
