"""What a skill remembers between control steps, and the rules on forces and grasps that all skills share."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any, TypeVar, cast

import numpy as np

from perdure.home.sim.arrays import BoolArray, FloatArray, IntArray
from perdure.home.sim.world import PrivilegedState

Record = TypeVar("Record", bound=Any)

FORCE_MARGIN = 20.0
"""Contact forces up to this count as 0, in [N] (M3's number). Only increases in force are penalized (OURS). M3's
`RobotForce` penalizes a lasting contact in every step, because its reference force does not rise with the contact."""
HOLD_LIMIT, HANDLE_LIMIT = 0.09, 0.2
"""Largest distance of a held object or handle from the gripper point in [m]; beyond it the grasp is invalid (M3)."""


@dataclass(frozen=True)
class SkillProgress:
    """What skills remember of n lanes. All arrays have shape (n,)."""

    elapsed: IntArray
    """Control steps since the skill began."""
    grasped: BoolArray
    """Whether the right object or handle has been held (place: it is held at the start)."""
    released: BoolArray
    """Whether it has been released after that."""
    lasting: IntArray
    """Number of consecutive steps, up to now, in which the object rested in its goal region (place)."""
    reached: BoolArray
    """Whether the drawer, door or object has been in its goal region."""
    away: BoolArray
    """Whether the gripper point has been more than 0.3 m from its rest position."""
    force: FloatArray
    """Counted contact force of the previous step in [N], see `counted_force`."""
    force_sum: FloatArray
    """Sum of its increases in [N]."""

    def __len__(self) -> int:
        """Return the number of lanes."""
        return len(self.elapsed)

    def __getitem__(self, lanes: IntArray | slice | BoolArray) -> SkillProgress:
        """Return the record of some lanes."""
        return SkillProgress(*[getattr(self, each.name)[lanes] for each in fields(self)])

    def put(self, lanes: IntArray, other: SkillProgress) -> SkillProgress:
        """Return a copy with the rows of `lanes` replaced, see `put_rows`."""
        return put_rows(self, lanes, other)


def put_rows(record: Record, lanes: IntArray, other: Record) -> Record:
    """Return a copy of a dataclass of arrays in which the rows of `lanes` (m,) come from another one with m rows."""
    changed = {}
    for each in fields(record):
        column = getattr(record, each.name).copy()
        column[lanes] = getattr(other, each.name)
        changed[each.name] = column
    return cast(Record, type(record)(**changed))


def invalid_grasp(state: PrivilegedState) -> BoolArray:
    """Return whether what is held is too far from the gripper. Shape (n,)."""
    limit = np.where(state.held >= 0, HOLD_LIMIT, HANDLE_LIMIT)
    return np.asarray(~state.empty_hand & (state.hold_error > limit))


def counted_force(state: PrivilegedState) -> FloatArray:
    """Return the contact force in [N], 0 up to `FORCE_MARGIN`. Shape (n,)."""
    return np.where(state.contact_force > FORCE_MARGIN, state.contact_force, 0.0)
