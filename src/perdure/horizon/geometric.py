"""The geometric embedding of the thesis: the time-to-go on several time scales at once."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from perdure.horizon.embedding import Embedding
from perdure.horizon.errors import HorizonError

SIZE_BY_TASK = {"Swimmer": 10}
"""The thesis' text (appendix A.2) says 10 for every task but Hopper; its rule gives 5 for Swimmer (d = 8) too. The text
wins, because it is what the figures are labelled with."""


@dataclass(frozen=True)
class Geometric(Embedding):
    """phi(t, T) = [lambda_i^(T - t)], lambda_i evenly spaced in [low, high], both ends included (thesis, 3.3.1).

    All ones when nothing is left (t >= T). As the time-to-go grows, every component goes to 0 but one with lambda = 1,
    which is constant; it is kept, as the thesis writes it.

    Raises:
        HorizonError: If there is no component, or the factors do not lie in [0, 1] in rising order.
    """

    name: ClassVar[str] = "geometric"

    size: int = 10
    """Number of factors d."""
    low: float = 0.99
    """Smallest factor: forgets all but the last few hundred steps."""
    high: float = 1.0
    """Largest factor."""

    def __post_init__(self) -> None:
        """Refuse factors outside [0, 1]."""
        if self.size < 1:
            raise HorizonError(f"a geometric embedding needs at least one component, got size {self.size}")
        if not 0 <= self.low <= self.high <= 1:
            raise HorizonError(f"geometric factors must satisfy 0 <= low <= high <= 1, got [{self.low}, {self.high}]")

    @cached_property
    def factors(self) -> NDArray[np.float64]:
        """lambda_1, ..., lambda_d, shape (d,)."""
        return np.linspace(self.low, self.high, self.size)

    def __call__(self, elapsed: Any, horizon: Any) -> Any:
        """Shape (*batch, size)."""
        left = horizon > elapsed
        # max(T - t, 0) by operators: the difference is computed from numbers that make it 0 where nothing is left.
        steps_to_go = (horizon - elapsed) * left
        exponent = steps_to_go[..., None] if hasattr(steps_to_go, "ndim") else steps_to_go
        return self.factors**exponent


def geometric_size(observation_size: int, task: str | None = None) -> int:
    """The thesis' size of the embedding: 10 if 10 < 2d/3 for observations of length d, else 5 (appendix A.2).

    For the six tasks: Hopper (d = 11) 5; HalfCheetah, Walker2d (17), Ant (111) and Humanoid (376) 10. Swimmer (d = 8)
    gets 10, against the rule and with the text (SIZE_BY_TASK).

    Args:
        observation_size: Length d of the observation without phi.
        task: The task's name, for the exception.
    """
    if task is not None and task.split("-")[0] in SIZE_BY_TASK:
        return SIZE_BY_TASK[task.split("-")[0]]
    return 10 if 3 * 10 < 2 * observation_size else 5
