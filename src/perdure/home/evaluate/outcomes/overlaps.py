"""Objects at rest that overlap: a check that the simulation kept solid objects apart.

The depth comes from the poses in the logs and the objects' own shapes. Which pairs the simulation let collide plays no
part, so the check also finds pairs that it wrongly left out.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import combinations
from typing import Any

import numpy as np

from perdure.home.errors import HomeError
from perdure.home.evaluate.log import EpisodeLog, FinalObject
from perdure.home.sim.objects import KINDS, AppleShape, YcbObjects

AT_REST = 0.01
"""Speed in [m/s] below which an object is at rest."""
DEEPEST = 0.005
"""Overlap in [m] that soft contacts may leave between two objects at rest."""


@dataclass(frozen=True)
class Overlap:
    """Two objects at rest, neither in the hand, one inside the other after the last step of an episode."""

    log: EpisodeLog
    first: int
    """Number of one object in the episode; targets come first."""
    second: int
    depth: float
    """How far one is inside the other in [m]."""

    @property
    def line(self) -> str:
        """For a terminal: the episode, the objects and the depth."""
        first, second = (f"{self.log.final_objects[k].kind} ({k})" for k in (self.first, self.second))
        return f"{self.log.name}: {first} and {second}, {1000 * self.depth:.1f} mm"


def find_overlaps(logs: Sequence[EpisodeLog], deeper_than: float = DEEPEST) -> Iterator[Overlap]:
    """Yield every pair of objects at rest that overlap by more than a depth in [m].

    Episodes that diverged and logs without final poses are passed over.
    """
    for log in logs:
        if log.diverged:
            continue
        apple: AppleShape = "hull" if "hull-apple" in log.strategy.split() else "sphere"
        at_rest = [k for k, each in enumerate(log.final_objects) if each.speed < AT_REST and not each.held]
        for first, second in combinations(at_rest, 2):
            depth = overlap_depth(log.final_objects[first], log.final_objects[second], apple)
            if depth > deeper_than:
                yield Overlap(log, first, second, depth)


def overlap_depth(first: FinalObject, second: FinalObject, apple: AppleShape = "sphere") -> float:
    """Return how far two objects overlap in [m]: the deepest pair of their convex pieces, 0 when they are apart."""
    if math.dist(first.position, second.position) > _radius(first.kind) + _radius(second.kind):
        return 0.0
    import mujoco

    model, pairs = _pair_model(first.kind, second.kind, apple)
    data = mujoco.MjData(model)
    data.qpos[:] = (*first.position, *first.quaternion, *second.position, *second.quaternion)
    mujoco.mj_kinematics(model, data)
    nearest = min(float(mujoco.mj_geomDistance(model, data, one, other, 1.0, None)) for one, other in pairs)
    return max(0.0, -nearest)


def _radius(kind: str) -> float:
    if kind not in KINDS:
        raise HomeError(f"the shape of {kind!r} is not known; there are {', '.join(KINDS)}")
    return float(np.linalg.norm(KINDS[kind].half))


@cache
def _pair_model(first: str, second: str, apple: AppleShape) -> tuple[Any, list[tuple[int, int]]]:
    """Return a model of two objects alone, and the pairs of their colliding geoms."""
    import mujoco

    spec = mujoco.MjSpec()
    objects = YcbObjects(visuals=False, apple=apple)
    for name, kind in (("first", first), ("second", second)):
        objects.add(spec, kind, name, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0))
    model = spec.compile()
    geoms = [np.flatnonzero(model.geom_bodyid == model.body(name).id).tolist() for name in ("first", "second")]
    return model, [(one, other) for one in geoms[0] for other in geoms[1]]
