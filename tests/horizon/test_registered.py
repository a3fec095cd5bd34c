"""A stranger adds an embedding, a clock or a distribution by subclassing, without touching a list."""

from abc import abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest

from perdure.errors import PerdureError
from perdure.horizon import (
    Clock,
    Embedding,
    Fixed,
    HorizonDistribution,
    HorizonProtocol,
)
from perdure.registry import Registered


@dataclass(frozen=True)
class Reciprocal(Embedding):
    """phi(t, T) = 1 / (1 + T - t)."""

    name: ClassVar[str] = "reciprocal-of-a-stranger"
    offset: float = 1.0

    @property
    def size(self):
        return 1

    def __call__(self, elapsed, horizon):
        return (1 / (self.offset + horizon - elapsed))[..., None]


@dataclass(frozen=True)
class Late(Clock):
    """A clock that is one step behind."""

    name: ClassVar[str] = "late-of-a-stranger"
    steps: float

    def time(self, elapsed):
        return elapsed - 1, self.steps + 0 * elapsed


def test_a_strangers_embedding_is_stored_and_found_by_name():
    protocol = HorizonProtocol(Reciprocal(2.0), Fixed(5), "terminated", 1.0, 1.0)
    again = HorizonProtocol.from_json(protocol.to_json())
    assert again.embedding == Reciprocal(2.0)
    assert again.embed(np.array([3.0]), np.array([5.0])).tolist() == [[0.25]]


def test_a_strangers_clock_is_found_by_name():
    assert Clock.from_json({"name": "late-of-a-stranger", "steps": 4}) == Late(4)


def test_the_same_field_values_of_another_kind_are_another_thing():
    assert Embedding.from_json({"name": "linear"}) != Embedding.from_json({"name": "geometric"})
    assert HorizonDistribution.from_json({"name": "fixed", "steps": 3}) != HorizonDistribution.from_json(
        {"name": "uniform", "low": 3, "high": 3}
    )


class Shape(Registered):
    """An abstract idea of our own, so that the clash below stays here."""

    @property
    @abstractmethod
    def corners(self):
        """Never asked."""


@dataclass(frozen=True)
class Square(Shape):
    name: ClassVar[str] = "square"
    side: float
    corners = 4


class Polygon(Shape):
    """A base without a name of its own and without abstract methods."""

    corners = 3


@dataclass(frozen=True)
class Triangle(Polygon):
    name: ClassVar[str] = "triangle"


def test_a_base_without_a_name_is_no_member():
    assert Shape.kinds()["triangle"] is Triangle
    assert Polygon not in Shape.kinds().values()


def test_infinity_and_numpy_numbers_become_plain_json_values():
    assert Square(np.inf).to_json() == {"name": "square", "side": "inf"}
    assert type(Square(np.float32(2)).to_json()["side"]) is float
    assert Shape.from_json({"name": "square", "side": "inf"}) == Square(np.inf)


def test_two_classes_of_one_name_are_refused_before_one_hides_the_other():
    again = type("Square", (Shape,), {"name": "square", "corners": 4, "__qualname__": "Square", "__module__": __name__})
    assert Shape.kinds() == {"square": again, "triangle": Triangle}, "a class that is defined again replaces itself"

    @dataclass(frozen=True)
    class CopiedAndForgotten(Shape):
        name: ClassVar[str] = "square"
        corners = 4

    with pytest.raises(PerdureError, match=r"Square.*CopiedAndForgotten.*'square'"):
        Shape.kinds()
