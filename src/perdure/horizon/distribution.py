"""Base class of horizon distributions: how long the next training episode may last."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any

from perdure.horizon.errors import HorizonError
from perdure.horizon.registered import Registered, from_json


class HorizonDistribution(Registered):
    """A distribution over horizons. Subclasses are frozen dataclasses and use array operators only."""

    @property
    @abstractmethod
    def longest(self) -> float:
        """Return the longest horizon it draws, in steps; may be infinite."""

    @abstractmethod
    def from_uniform(self, u: Any) -> Any:
        """Return horizons in steps, shaped like ``u``, from numbers drawn uniformly in [0, 1)."""


def distribution_from_json(values: Any) -> HorizonDistribution:
    """Return the distribution that its `to_json` described.

    Args:
        values: ``{"name": ..., field: value, ...}``.

    Raises:
        HorizonError: If there is no such distribution or a field is unknown or out of range.
    """
    return from_json(HorizonDistribution, values)  # type: ignore[type-abstract]


def check_steps(name: str, steps: float) -> None:
    """Refuse a horizon that is not a whole number of steps, at least 1.

    Args:
        name: What the number is, for the message.
        steps: The number.

    Raises:
        HorizonError: With the name of the field and the bad value.
    """
    if not (steps >= 1 and float(steps).is_integer()):
        raise HorizonError(f"{name} must be a whole number of steps, at least 1, got {steps}")
