"""Geometric embedding of the thesis: the time-to-go on several time scales."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from perdure.horizon.embedding import Embedding
from perdure.horizon.errors import HorizonError

SIZE_BY_TASK = {"Swimmer": 10}
"""Where the thesis contradicts itself (appendix A.2): its text says 10 for every task but Hopper-v3, yet its rule gives
5 for Swimmer-v3 (d = 8) as well. We follow the text, because it names the tasks."""


@dataclass(frozen=True)
class Geometric(Embedding):
    """phi(t, T) = [lambda_i^(T - t)], lambda_i evenly spaced in [low, high], both ends included (thesis, 3.3.1).

    All ones when nothing is left (t >= T). As the time-to-go grows, every component with lambda < 1 goes to 0.
    The component with lambda = 1 is constant; it is kept, as in the thesis.

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
        if not isinstance(self.size, int) or self.size < 1:
            raise HorizonError(
                f"a geometric embedding needs a whole number of components, at least 1, got {self.size!r}"
            )
        if not 0 <= self.low <= self.high <= 1:
            raise HorizonError(f"geometric factors must satisfy 0 <= low <= high <= 1, got [{self.low}, {self.high}]")

    @property
    def factors(self) -> NDArray[np.float64]:
        """Return lambda_1, ..., lambda_d, shape (d,)."""
        # A new array each time: JAX remembers an array by identity, in the precision in which it met it first.
        return np.linspace(self.low, self.high, self.size)

    def __call__(self, elapsed: Any, horizon: Any) -> Any:
        """Return phi(t, T), shape (*batch, size); in float32 exact to about 1e-5, in float64 to 1e-12."""
        left = horizon > elapsed
        # max(T - t, 0) by operators, for traced arrays.
        steps_to_go = (horizon - elapsed) * left
        exponent = steps_to_go[..., None] if hasattr(steps_to_go, "ndim") else steps_to_go
        if not isinstance(exponent, np.ndarray | float | int):
            return self.factors**exponent
        # With a scalar exponent of 2 NumPy squares instead of calling pow, and the two differ in the last bit under
        # AVX-512. One exponent per factor keeps every row independent of its neighbors.
        factors = self.factors if self.size > 1 else self.factors.repeat(2)
        return np.power(factors, exponent + 0.0 * factors)[..., : self.size]


def robot_of(task: str) -> str:
    """Return the robot of a task in any version, of EnvPool or Gymnasium: "gymnasium:Hopper-v5" -> "Hopper"."""
    return task.removeprefix("gymnasium:").split("-")[0]


def geometric_size(observation_size: int, task: str | None = None) -> int:
    """Return the thesis' embedding size: 10 if 10 < 2d/3 for observations of length d, else 5 (appendix A.2).

    For the six tasks: Hopper (d = 11) 5; HalfCheetah, Walker2d (17), Ant (111) and Humanoid (376) 10. Swimmer (d = 8)
    gets 10, against the rule and with the text (SIZE_BY_TASK).

    Args:
        observation_size: Length d of the observation without phi.
        task: The task's name, for the exception.
    """
    robot = "" if task is None else robot_of(task)
    if robot in SIZE_BY_TASK:
        return SIZE_BY_TASK[robot]
    return 10 if 2 * observation_size > 3 * 10 else 5
