"""Every pose at every step, from any simulator, and what a log keeps of it: events, releases, skill runs."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from perdure.home.benchmark.tasks import WorldFacts, predicate
from perdure.home.benchmark.tasks.predicates import PREDICATES, at
from perdure.home.errors import HomeError
from perdure.home.evaluate.log.episode_log import Event, Release, SkillRun, Track, kept_steps
from perdure.home.sim.arrays import FloatArray

GRID = 2.0**-13
"""Poses of tracks are rounded to multiples of this (0.12 mm), which lets a file shrink."""
_DOORS = [predicate(f"{name}()") for name in PREDICATES if name.endswith(("drawer", "fridge"))]


@dataclass(frozen=True)
class History:
    """An episode and the settling time after it, step by step."""

    facts: WorldFacts
    """Targets, goals, held, drawer, fridge. Leading axis (steps,)."""
    up: FloatArray
    """Height of the targets' own z axes: 1 upright, 0 lying. Shape (steps, targets)."""
    speed: FloatArray
    """Speed of the targets in [m/s]. Shape (steps, targets)."""
    gripper: FloatArray
    """Gripper point in the room in [m]. Shape (steps, 3)."""
    base: FloatArray
    """Base in the room: x, y, heading. Shape (steps, 3)."""
    force: FloatArray
    """Largest normal contact force at the robot in [N]; nan if unknown. Shape (steps,)."""
    control_hz: float

    def __post_init__(self) -> None:
        """Arrays of different lengths raise HomeError."""
        lengths = {e.name: len(getattr(self, e.name)) for e in fields(self) if e.name != "control_hz"}
        if len(set(lengths.values())) != 1 or not len(self.facts):
            raise HomeError(f"a history needs as many steps of everything, and at least one; it has {lengths}")

    @property
    def events(self) -> tuple[Event, ...]:
        """The state at the first step, and at each step at which a condition of a stage may change."""
        facts, inside = self.facts, at(self.facts)
        state = np.column_stack([facts.held, inside, *(door.holds(facts) for door in _DOORS)]).astype(np.int64)
        changes = np.concatenate([[0], 1 + np.flatnonzero((state[1:] != state[:-1]).any(axis=1))])
        return tuple(
            Event(
                step=int(k),
                held=int(facts.held[k]),
                in_goal=tuple(map(bool, inside[k])),
                drawer=float(facts.drawer[k]),
                fridge=float(facts.fridge[k]),
            )
            for k in changes
        )

    @property
    def releases(self) -> tuple[Release, ...]:
        """Every release of a target, in order."""
        held = np.asarray(self.facts.held)
        let_go = np.flatnonzero((held[:-1] >= 0) & (held[1:] != held[:-1]))
        return tuple(self._release(int(step), int(held[step])) for step in let_go)

    def measured(self, run: SkillRun) -> SkillRun:
        """Return a skill run with the largest force and the smallest reach of its steps."""
        if run.end <= run.begin:
            return run
        steps = slice(run.begin, run.end)
        away = np.linalg.norm(self.gripper[steps] - self.facts.object_positions[steps, run.target], axis=1)
        return replace(run, force=float(self.force[steps].max()), reach=float(away.min()))

    def _release(self, step: int, target: int) -> Release:
        again = np.flatnonzero(self.facts.held[step + 1 :] == target)
        rows = slice(step, step + 1 + int(again[0]) if len(again) else len(self.facts))
        position, up = _rounded(self.facts.object_positions[rows, target]), _rounded(self.up[rows, target])
        kept, before = kept_steps(position, up), max(step - 1, 0)
        return Release(
            target=target,
            object_speed=float(self.speed[step, target]),
            gripper_speed=float(np.linalg.norm(self.gripper[step] - self.gripper[before])) * self.control_hz,
            base_speed=float(np.linalg.norm(self.base[step, :2] - self.base[before, :2])) * self.control_hz,
            track=Track(
                step=step + kept,
                position=position[kept],
                up=up[kept],
                gripper=_rounded(self.gripper[rows][kept]),
                base=_rounded(self.base[rows][kept]),
            ),
        )


def _rounded(values: FloatArray) -> FloatArray:
    return np.round(values / GRID) * GRID
