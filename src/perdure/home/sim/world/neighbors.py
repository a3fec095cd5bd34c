"""The neighbors of a target: objects and handles that a grasp could take instead.

The magic grasp takes the nearest handle within reach, else the nearest object, so a robot that picks must know them;
its head camera would show them.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from perdure.home.sim.arrays import FloatArray, IntArray
from perdure.home.sim.world.handles import Handles
from perdure.home.sim.world.scene import Scene
from perdure.home.sim.world.simulator import Simulator
from perdure.home.sim.world.state import norm

NEIGHBORS = 2
"""Number of nearest neighbors in the state."""
NEIGHBORHOOD = 0.5
"""Largest distance of a neighbor from the target in [m]."""


class Neighbors(NamedTuple):
    """The neighbors of the targets of n lanes."""

    from_object: FloatArray
    """From the target to the nearest other objects, in the room; 0 where there is none. Shape (n, NEIGHBORS, 3)."""
    distance: FloatArray
    """From the gripper point to the nearest other object in [m], inf without one. Shape (n,)."""
    handle_distance: FloatArray
    """From the gripper point to the nearest handle in [m], inf without one. Shape (n,)."""


def no_neighbors(n: int) -> Neighbors:
    """Return empty neighborhoods of n targets."""
    return Neighbors(np.zeros((n, NEIGHBORS, 3)), np.full(n, np.inf), np.full(n, np.inf))


class Surroundings:
    """Objects and handles of n lanes, so that all are searched at once; missing ones are infinitely far."""

    def __init__(self, lanes: int) -> None:
        """Begin without scenes."""
        self._scenes: list[Scene | None] = [None] * lanes
        self._middles = np.full((lanes, NEIGHBORS + 1, 3), np.inf)
        self._objects = np.zeros(lanes, dtype=np.int64)
        self._positions = np.zeros((lanes, 1))
        self._handles = Handles.none(lanes, 1)

    def look(self, numbers: IntArray, lanes: Sequence[Simulator], targets: IntArray, grippers: FloatArray) -> Neighbors:
        """Return the neighbors of targets in n lanes, from their numbers (n,), the lanes and the gripper points (n, 3).

        A target (n,) that a scene does not have has no neighbors but handles.
        """
        for number, lane in zip(numbers.tolist(), lanes, strict=True):
            if self._scenes[number] is not lane.scene:
                self._enter(number, lane.scene)
            self._middles[number, : self._objects[number]] = lane.qpos[lane.scene.middles]
            self._positions[number, : len(lane.scene.links)] = lane.links
        handles = self._handles[numbers].at(self._positions[numbers])
        handle_distance = norm((handles - grippers[:, None]).reshape(-1, 3)).reshape(len(numbers), -1).min(axis=1)
        return Neighbors(*self._around(numbers, targets, grippers), handle_distance)

    def _around(self, numbers: IntArray, targets: IntArray, grippers: FloatArray) -> tuple[FloatArray, FloatArray]:
        middles, rows = self._middles[numbers], np.arange(len(numbers))
        known = (targets >= 0) & (targets < self._objects[numbers])
        target = np.where(known, targets, 0)
        at = np.where(known[:, None], middles[rows, target], 0.0)
        middles[rows, target] = np.inf
        middles[~known] = np.inf
        distance = norm((middles - grippers[:, None]).reshape(-1, 3)).reshape(len(rows), -1).min(axis=1)
        apart = middles - at[:, None]
        away = norm(apart.reshape(-1, 3)).reshape(len(rows), -1)
        nearest = np.argsort(away, axis=1, kind="stable")[:, :NEIGHBORS]
        near = np.take_along_axis(away, nearest, axis=1) <= NEIGHBORHOOD
        return np.where(near[:, :, None], apart[rows[:, None], nearest], 0.0), distance

    def _enter(self, number: int, scene: Scene) -> None:
        """Make room for another scene."""
        objects, links = len(scene.placements), len(scene.links)
        more = objects - self._middles.shape[1]
        if more > 0:
            self._middles = np.pad(self._middles, ((0, 0), (0, more), (0, 0)), constant_values=np.inf)
        more = links - self._positions.shape[1]
        if more > 0:
            self._positions = np.pad(self._positions, ((0, 0), (0, more)))
            self._handles = self._handles.widened(more)
        self._middles[number], self._positions[number] = np.inf, 0.0
        self._handles.put(number, scene.handles)
        self._scenes[number], self._objects[number] = scene, objects
