"""Types of arrays and vectors, and records of lanes."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Self

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
Vec3 = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
"""(w, x, y, z)."""


@dataclass(frozen=True)
class Rows:
    """Base of a dataclass whose fields are arrays with a row for each of n lanes."""

    def __len__(self) -> int:
        """Return the number of lanes."""
        return len(getattr(self, fields(self)[0].name))

    def __getitem__(self, lanes: IntArray | slice | BoolArray) -> Self:
        """Return the record of some lanes."""
        return type(self)(*[getattr(self, each.name)[lanes] for each in fields(self)])

    def put(self, lanes: IntArray, other: Self) -> Self:
        """Return a copy in which the rows of `lanes` (m,) come from another record with m rows."""
        changed = self[np.arange(len(self))]
        for each in fields(self):
            getattr(changed, each.name)[lanes] = getattr(other, each.name)
        return changed
