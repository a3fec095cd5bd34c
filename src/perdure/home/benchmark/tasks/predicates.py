"""The seven conditions of which the benchmark's stages are made.

As in M3 (hab-mobile-manipulation, `habitat_extensions/tasks/rearrange/composite_sensors.py`):

| written | true when |
|---|---|
| `at(i)` | target i is within 0.15 m of its goal: positions only, in space, whatever its speed |
| `holding(i)` | the gripper holds target i |
| `not_holding()` | the gripper holds nothing, no handle either |
| `opened_drawer()` | the drawer of target 0 is out by 0.4 m or more |
| `closed_drawer()` | ... by 0.1 m or less |
| `opened_fridge()` | the fridge's upper door is open by 1.57 - 0.15 = 1.42 rad or more |
| `closed_fridge()` | ... by 0.15 rad or less |
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from perdure.home.benchmark.tasks.facts import NOTHING, WorldFacts
from perdure.home.errors import HomeError
from perdure.home.sim.arrays import BoolArray

AT = 0.15
"""Largest distance in [m] of an object that is at its goal."""
DRAWER_OPEN, DRAWER_CLOSED = 0.4, 0.1
FRIDGE_OPENED, FRIDGE_CLOSED = 1.57 - 0.15, 0.15


def at(facts: WorldFacts) -> BoolArray:
    """Return which targets are at their goals. Shape (*, targets)."""
    return np.asarray(np.linalg.norm(facts.object_positions - facts.goal_positions, axis=-1) <= AT)


_ABOUT_A_TARGET: dict[str, Callable[[WorldFacts, int], BoolArray]] = {
    "at": lambda facts, i: at(facts)[..., i],
    "holding": lambda facts, i: np.asarray(facts.held == i),
}
_ABOUT_THE_WORLD: dict[str, Callable[[WorldFacts], BoolArray]] = {
    "not_holding": lambda facts: np.asarray(facts.held == NOTHING),
    "opened_drawer": lambda facts: np.asarray(facts.drawer >= DRAWER_OPEN),
    "closed_drawer": lambda facts: np.asarray(facts.drawer <= DRAWER_CLOSED),
    "opened_fridge": lambda facts: np.asarray(facts.fridge >= FRIDGE_OPENED),
    "closed_fridge": lambda facts: np.asarray(facts.fridge <= FRIDGE_CLOSED),
}
PREDICATES = (*_ABOUT_A_TARGET, *_ABOUT_THE_WORLD)
"""Names of all conditions."""


@dataclass(frozen=True)
class Predicate:
    """One condition, such as `at(1)`; made by `predicate`."""

    name: str
    target: int | None = None

    def __str__(self) -> str:
        return f"{self.name}({'' if self.target is None else self.target})"

    def holds(self, facts: WorldFacts) -> BoolArray:
        """Return where the condition is met. Shape (*)."""
        if self.target is None:
            return _ABOUT_THE_WORLD[self.name](facts)
        if self.target >= facts.targets:
            raise HomeError(f"{self} is about a target that is not there: the facts know {facts.targets} targets")
        return _ABOUT_A_TARGET[self.name](facts, self.target)


def predicate(text: str) -> Predicate:
    """Read a condition such as `at(1)` or `not_holding()`; anything else raises HomeError."""
    match = re.fullmatch(r"(\w+)\((\d*)\)", text)
    name, number = match.groups() if match else (text, "")
    if name in _ABOUT_A_TARGET and number:
        return Predicate(name, int(number))
    if name in _ABOUT_THE_WORLD and match and not number:
        return Predicate(name)
    valid = [f"{n}(i)" for n in _ABOUT_A_TARGET] + [f"{n}()" for n in _ABOUT_THE_WORLD]
    raise HomeError(f"no condition reads {text!r}; there are {', '.join(valid)}")
