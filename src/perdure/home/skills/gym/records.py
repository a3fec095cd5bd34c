"""Putting records of some lanes into those of all, and Gymnasium's form of an info."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from perdure.home.sim.world import PrivilegedState

IntArray = NDArray[np.int64]


def put(state: PrivilegedState, lanes: IntArray, fresh: PrivilegedState) -> PrivilegedState:
    """A copy in which some lanes are those of another record."""
    changed = {}
    for each in fields(PrivilegedState):
        column = getattr(state, each.name).copy()
        column[lanes] = getattr(fresh, each.name)
        changed[each.name] = column
    return PrivilegedState(**changed)


def masked(info: dict[str, Any]) -> dict[str, Any]:
    """An info with `_name` beside each entry, which says which lanes have it: here all. Entries of shape (n, ...)."""
    size = len(next(value for value in info.values() if isinstance(value, np.ndarray)))
    return {**info, **{f"_{name}": np.ones(size, dtype=bool) for name in info}}
