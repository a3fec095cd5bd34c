"""What a skill is: pure functions over `PrivilegedState` and `Progress`. Environments and executor drive them.

Nothing here keeps state: what a skill must remember is in `Progress`, which `begin` makes and `advance` renews. All
functions work row by row, so a lane's result does not depend on its neighbors.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from perdure.home.benchmark.tasks import LIMITS, SkillName
from perdure.home.sim.robot.data import BASE_RADIUS, REST_POSITION
from perdure.home.sim.world import ARM_STEP, BASE_SPEED, PrivilegedState
from perdure.home.sim.world.state import norm

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]

SUCCESS_REWARD = 2.5
SLACK = 0.002
"""Taken in every step (M3; not when a drawer or door is opened or closed)."""
PENALTY = 1.0
"""Taken when a failure ends the skill (M3)."""
FORCE_COST, FORCE_CAP, FORCE_MARGIN = 0.001, 0.2, 20.0
"""Cost per newton by which the contact force rose, its cap per step, and the force in [N] that does not count (M3)."""
HOLD_LIMIT, HANDLE_LIMIT = 0.09, 0.2
"""How far what is held may be from the gripper point in [m] before the grasp is invalid: objects, handles (M3)."""
SECTOR_DEPTH = 1.0
"""From how far furniture begins to be felt in [m], counted from the base's rim (OURS)."""
RETRACTED = 0.05
"""How near the gripper point must be to its rest position in [m] to count as retracted (M3)."""


@dataclass(frozen=True)
class Element:
    """One number of an observation."""

    name: str
    meaning: str
    unit: str
    low: float = -np.inf
    high: float = np.inf


@dataclass(frozen=True)
class Progress:
    """What skills remember of n lanes. All arrays have shape (n,)."""

    elapsed: IntArray
    """Control steps since the skill began."""
    grasped: BoolArray
    """Whether the right thing was held at some step (for place: at the start)."""
    released: BoolArray
    """Whether it was let go after that."""
    lasting: IntArray
    """For how many steps without a break the skill's condition holds (place: the object rests at its goal)."""
    reached: BoolArray
    """Whether the drawer or door was where it should be at some step."""
    away: BoolArray
    """Whether the gripper point was more than 0.3 m from its rest position at some step."""
    force: FloatArray
    """Contact force of the step before in [N], as far as it counts."""
    force_sum: FloatArray
    """Sum of its rises in [N]."""

    def __len__(self) -> int:
        """Number of lanes."""
        return len(self.elapsed)

    def __getitem__(self, lanes: IntArray | slice | BoolArray) -> Progress:
        """Some of the lanes."""
        return Progress(*[getattr(self, each.name)[lanes] for each in fields(self)])

    def put(self, lanes: IntArray, other: Progress) -> Progress:
        """A copy in which some lanes are those of another record."""
        changed = {}
        for each in fields(self):
            column = getattr(self, each.name).copy()
            column[lanes] = getattr(other, each.name)
            changed[each.name] = column
        return Progress(**changed)


@dataclass(frozen=True)
class Skill(ABC):
    """A skill of the benchmark."""

    name: ClassVar[SkillName]
    base_speed: ClassVar[float] = BASE_SPEED
    """What a base action of 1 means in [m/s] and [rad/s]."""
    arm_step: ClassVar[float] = ARM_STEP
    """What an arm action of 1 means in [rad] per step."""
    scan_reach: ClassVar[float] = BASE_RADIUS + SECTOR_DEPTH
    """How far its observation looks around the base in [m]; 0 for not at all. What is farther must not change the
    observation: an executor scans once for all skills, as far as the one that looks farthest."""
    needs_neighbors: ClassVar[bool] = False
    slack: ClassVar[float] = SLACK
    """What every step costs."""
    failures: ClassVar[tuple[str, ...]] = ("none", "invalid grasp", "excess force")
    """What the numbers mean that `failure` returns; 0 is no failure."""
    force_limit: ClassVar[float] = np.inf
    """Sum of rises of the contact force in [N] that ends the skill."""

    @property
    def limit(self) -> int:
        """Control steps after which it is stopped."""
        return LIMITS[self.name]

    @property
    @abstractmethod
    def elements(self) -> tuple[Element, ...]:
        """What the numbers of an observation are, in order."""

    @abstractmethod
    def observe(self, state: PrivilegedState, progress: Progress) -> FloatArray:
        """Observations. Shape (n, len(elements))."""

    @abstractmethod
    def terms(
        self, before: PrivilegedState, after: PrivilegedState, was: Progress, now: Progress
    ) -> Mapping[str, FloatArray]:
        """The reward of a step, term by term, without success, slack, force and failure. Each of shape (n,)."""

    @abstractmethod
    def success(self, state: PrivilegedState, progress: Progress) -> BoolArray:
        """Whether the skill has reached its end. Shape (n,)."""

    def lacks(self, state: PrivilegedState, progress: Progress) -> Mapping[str, BoolArray]:
        """What success still lacks, in words, most basic first; some is true where `success` is false. Each of (n,)."""
        return {}

    @abstractmethod
    def stop(self, state: PrivilegedState, progress: Progress) -> BoolArray:
        """Whether the executor goes on to the next skill: M3's stop rules, time-outs are its own affair. Shape (n,)."""

    def mask(self, actions: FloatArray, state: PrivilegedState) -> FloatArray:
        """Actions with what the skill forbids taken out. Shape (n, 11)."""
        return actions

    def begin(self, state: PrivilegedState) -> Progress:
        """What is remembered at the first step."""
        n, empty = len(state), np.zeros(len(state), dtype=bool)
        fresh = Progress(
            elapsed=np.zeros(n, dtype=np.int64),
            grasped=empty,
            released=empty,
            lasting=np.zeros(n, dtype=np.int64),
            reached=empty,
            away=empty,
            force=counted_force(state),
            force_sum=np.zeros(n),
        )
        return self._remember(fresh, state)

    def advance(self, progress: Progress, state: PrivilegedState) -> Progress:
        """What is remembered one control step later."""
        force = counted_force(state)
        rise = np.maximum(force - progress.force, 0.0)
        later = replace(progress, elapsed=progress.elapsed + 1, force=force, force_sum=progress.force_sum + rise)
        return self._remember(later, state)

    def failure(self, state: PrivilegedState, progress: Progress) -> IntArray:
        """Which failure ends the skill, 0 for none; the first of several in the order of `failures`. Shape (n,)."""
        return first_of(invalid_grasp(state), progress.force_sum > self.force_limit)

    def reward(
        self, before: PrivilegedState, after: PrivilegedState, was: Progress, now: Progress
    ) -> tuple[FloatArray, Mapping[str, FloatArray]]:
        """Reward of a step and its terms. Shape (n,) each."""
        terms = dict(self.terms(before, after, was, now))
        rise = np.maximum(now.force - was.force, 0.0)
        terms["force"] = -np.minimum(FORCE_COST * rise, FORCE_CAP)
        terms["slack"] = np.full(len(now), -self.slack)
        terms["failure"] = np.where(self.failure(after, now) > 0, -PENALTY, 0.0)
        terms["success"] = np.where(self.success(after, now), SUCCESS_REWARD, 0.0)
        total = np.zeros(len(now))
        for value in terms.values():
            total = total + value
        return total, terms

    def _remember(self, progress: Progress, state: PrivilegedState) -> Progress:
        """Skills renew their own part of the memory here."""
        return replace(progress, away=progress.away | (rest_distance(state) > 0.3))


def first_of(*conditions: BoolArray) -> IntArray:
    """1 where the first condition holds, else 2 where the second does, and so on; 0 where none does."""
    result = np.zeros(len(conditions[0]), dtype=np.int64)
    for number, condition in reversed(list(enumerate(conditions, start=1))):
        result[condition] = number
    return result


def rest_distance(state: PrivilegedState) -> FloatArray:
    """d_ee^r: distance of the gripper point from its rest position in [m]. Shape (n,)."""
    return norm(state.gripper_in_base - np.asarray(REST_POSITION))


def invalid_grasp(state: PrivilegedState) -> BoolArray:
    """Whether what is held has been torn too far from the gripper. Shape (n,)."""
    limit = np.where(state.held >= 0, HOLD_LIMIT, HANDLE_LIMIT)
    invalid: BoolArray = ~state.empty_hand & (state.hold_error > limit)
    return invalid


def counted_force(state: PrivilegedState) -> FloatArray:
    """The contact force as far as it counts in [N]. Shape (n,)."""
    return np.where(state.contact_force > FORCE_MARGIN, state.contact_force, 0.0)
