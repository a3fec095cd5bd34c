"""Base class of clocks: the time that a policy's embedding receives at deployment."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any

from perdure.horizon.errors import HorizonError
from perdure.horizon.registered import Registered, from_json


class Clock(Registered):
    """Map elapsed steps since reset to the (t, T) that the embedding receives.

    Subclasses are frozen dataclasses with one number, ``steps``, and use array operators only.
    """

    steps: float
    """The clock's one setting, in steps."""

    def __post_init__(self) -> None:
        """Refuse a negative or undefined number of steps."""
        if not self.steps >= 0:
            raise HorizonError(f"a {self.name} clock needs 0 steps or more, got {self.steps}")

    @abstractmethod
    def time(self, elapsed: Any) -> tuple[Any, Any]:
        """Return (t, T) for elapsed steps of shape (n,): two arrays of shape (n,)."""

    @property
    def label(self) -> str:
        """Return a short text for tables, such as "constant(500)"."""
        return f"{self.name}({str(float(self.steps)).removesuffix('.0')})"


def clock_from_json(values: Any) -> Clock:
    """Return the clock that its `to_json` described.

    Args:
        values: ``{"name": ..., "steps": ...}``.

    Raises:
        HorizonError: If there is no such clock or its number of steps is out of range.
    """
    return from_json(Clock, values)  # type: ignore[type-abstract]


def parse_clock(text: str) -> Clock:
    """Return the clock of a text such as "constant:500", "periodic:200", "countdown:100000", or of a clock's label.

    Args:
        text: Name and steps.

    Raises:
        HorizonError: If the text names no clock, or its number of steps is out of range.
    """
    name, _, steps = text.strip().replace("(", ":").rstrip(")").partition(":")
    try:
        number = float(steps)
    except ValueError:
        raise HorizonError(f"a clock is written name:steps, for example constant:500, got {text!r}") from None
    return clock_from_json({"name": name, "steps": number})
