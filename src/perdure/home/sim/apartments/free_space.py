"""Where a round robot can be, and how far it is from there to anywhere: a grid, its islands, geodesic distances.

A cell of the grid is free when its middle keeps the robot's radius from every footprint and lies inside the room. That
test is exact (distances to rectangles, no rasterised obstacles). Cells are joined to their eight neighbors, diagonally
only when both cells beside the diagonal are free too.

How good are the distances? Between two cells that see each other, with d the straight distance, the grid gives

    d <= grid distance <= d / cos(pi / 8) = 1.0824 d,

equal on the left along rows, columns and diagonals, on the right at 22.5 degrees. `Geodesic.path` pulls the grid path
tight, which removes most of that. How safe are the edges? All footprints are convex, so a segment of length s between
two points at clearance r keeps at least sqrt(r^2 - s^2 / 4): 0.298 m for r = 0.3 m and 0.05 m cells.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from perdure.home.errors import HomeError
from perdure.home.sim.apartments import plane
from perdure.home.sim.apartments.footprint import apartment_footprints
from perdure.home.sim.apartments.piece import Apartment
from perdure.home.sim.arrays import BoolArray, FloatArray, IntArray

CELL = 0.05
"""Side of a cell in [m], as M3's navigation regions."""
RADIUS = 0.3
"""Radius of the robot in [m], as M3's navigation mesh (the Fetch's own base has 0.285)."""
_STEPS = ((0, 1), (1, 0), (1, 1), (1, -1))


@dataclass(frozen=True)
class FreeSpace:
    """The free cells of a room for a robot of one radius. Built by `free_space` or `FreeSpace.of`."""

    room: tuple[tuple[float, float], ...]
    rectangles: FloatArray
    """Footprints in the way. Shape (n, 5)."""
    radius: float
    free: BoolArray
    """Which cells are free; row along y, column along x. Shape (rows, columns)."""

    @staticmethod
    def of(room: Sequence[tuple[float, float]], rectangles: FloatArray, radius: float = RADIUS) -> FreeSpace:
        """Return the free space of a room with footprints (n, 5) in it, its own walls among them; lengths in [m]."""
        if not radius >= 0.0:
            raise HomeError(f"radius must be at least 0, not {radius}")
        low, high = np.min(room, axis=0), np.max(room, axis=0)
        columns, rows = np.ceil((high - low) / CELL - 1e-9).astype(int)
        points = _centers(low, np.indices((rows, columns)))  # (rows, columns, 2)
        free = plane.inside(points.reshape(-1, 2), room).reshape(rows, columns)
        for rectangle in rectangles:  # each one only looks at the cells around it
            ring = (plane.corners(rectangle[None])[0] - low) / CELL
            (left, bottom), (right, top) = ring.min(axis=0) - radius / CELL, ring.max(axis=0) + radius / CELL
            near = np.s_[max(int(bottom), 0) : max(int(top) + 1, 0), max(int(left), 0) : max(int(right) + 1, 0)]
            local = points[near].reshape(-1, 2)
            free[near] &= (plane.clearance(local, rectangle[None]) >= radius).reshape(free[near].shape)
        return FreeSpace(tuple(room), rectangles, radius, free)

    @cached_property
    def centers(self) -> FloatArray:
        """Middles of the free cells, in the order used everywhere below. Shape (n, 2)."""
        return _centers(np.min(self.room, axis=0), np.array(np.nonzero(self.free)))

    @cached_property
    def island(self) -> IntArray:
        """The island each free cell belongs to, 0 the largest. Shape (n,)."""
        from scipy.sparse.csgraph import connected_components

        _, labels = connected_components(self._graph, directed=False)
        by_size = np.argsort(-np.bincount(labels), kind="stable")
        rank = np.empty(len(by_size), dtype=np.int64)
        rank[by_size] = np.arange(len(by_size))
        return np.asarray(rank[labels])

    @property
    def areas(self) -> FloatArray:
        """Area of each island in [m^2], largest first. Shape (islands,)."""
        return np.bincount(self.island).astype(np.float64) * CELL**2

    def is_free(self, points: FloatArray) -> BoolArray:
        """Return whether the robot can stand at points, which need not be cell centers. Shape (m, 2) -> (m,)."""
        return (plane.clearance(points, self.rectangles) >= self.radius) & plane.inside(points, self.room)

    def nearest(self, points: FloatArray) -> tuple[IntArray, FloatArray]:
        """Return the nearest free cell of the largest island to each point, and its distance in [m].

        Shape (m, 2) -> indices into `centers`, shape (m,), and distances, shape (m,).
        """
        members, tree = self._main_tree
        distance, index = tree.query(points)
        return members[index], distance

    def cell_at(self, x: float, y: float) -> int:
        """Return the index in `centers` of the cell at a point, else of the nearest cell of the largest island."""
        left, bottom, numbers = self._main_grid
        row, column = int((y - bottom) // CELL), int((x - left) // CELL)
        if 0 <= row < numbers.shape[0] and 0 <= column < numbers.shape[1]:
            found = int(numbers[row, column])
            if found >= 0:
                return found
        return int(self.nearest(np.array([[x, y]]))[0][0])

    def distances(self, goals: IntArray, cost: FloatArray | None = None) -> Geodesic:
        """Return geodesic distances from every free cell to the nearest of some goal cells, indices of shape (k,).

        `cost` is what a meter costs at each free cell, shape (n,); distances are then costs. 1 everywhere when None.
        """
        from scipy.sparse.csgraph import dijkstra

        if len(goals) == 0:
            raise HomeError("geodesic distances need at least one goal cell")
        graph = self._graph
        if cost is not None:
            graph = graph.tocoo()
            graph.data = graph.data * 0.5 * (cost[graph.row] + cost[graph.col])
            graph = graph.tocsr()
        value, toward, _ = dijkstra(graph, directed=False, indices=goals, min_only=True, return_predecessors=True)
        return Geodesic(self, value, toward.astype(np.int64))

    @cached_property
    def _main_grid(self) -> tuple[float, float, IntArray]:
        """Left and bottom of the grid, and for each cell its index among the free cells, -1 off the largest island."""
        numbers = np.full(self.free.shape, -1, dtype=np.int64)
        numbers[self.free] = np.where(self.island == 0, np.arange(len(self.island)), -1)
        left, bottom = np.min(self.room, axis=0).tolist()
        return left, bottom, numbers

    @cached_property
    def _main_tree(self) -> tuple[IntArray, Any]:
        from scipy.spatial import cKDTree

        if not self.free.any():
            raise HomeError("this room has no free cell at all")
        members = np.nonzero(self.island == 0)[0]
        return members, cKDTree(self.centers[members])

    @cached_property
    def _graph(self) -> Any:
        from scipy.sparse import csr_array

        free = self.free
        number = np.full((free.shape[0] + 2, free.shape[1] + 2), -1, dtype=np.int64)  # a border of -1
        number[1:-1, 1:-1][free] = np.arange(int(free.sum()))
        here = np.nonzero(number >= 0)
        starts, ends, lengths = [], [], []
        for down, right in _STEPS:
            there = number[here[0] + down, here[1] + right]
            joined = there >= 0
            if down and right:
                beside = np.minimum(number[here[0] + down, here[1]], number[here[0], here[1] + right])
                joined &= beside >= 0
            starts.append(number[here][joined])
            ends.append(there[joined])
            lengths.append(np.full(int(joined.sum()), CELL * np.hypot(down, right)))
        size = int(free.sum())
        edges = (np.concatenate(starts), np.concatenate(ends))
        return csr_array((np.concatenate(lengths), edges), shape=(size, size))


@dataclass(frozen=True)
class Geodesic:
    """Distances along free cells to the nearest goal cell, and the way there. Built by `FreeSpace.distances`."""

    space: FreeSpace
    values: FloatArray
    """Distance of each free cell in [m], inf on other islands. Shape (n,)."""
    toward: IntArray
    """The next cell on the way to the goal, negative at goals and on other islands. Shape (n,)."""
    _kept: dict[int, IntArray] = field(default_factory=dict, repr=False)

    def at(self, points: FloatArray) -> FloatArray:
        """Return the distance of points to the goals, via the nearest cell of the largest island. (m, 2) -> (m,)."""
        index, first = self.space.nearest(points)
        return first + self.values[index]

    def ahead(self, x: float, y: float, cells: int) -> tuple[float, float, float]:
        """Return distance from a point, and the middle (x, y) of the cell so many cells on the way."""
        index = self.space.cell_at(x, y)
        here, later = self.space.centers[index], self.space.centers[self._later(cells)[index]]
        first = math.hypot(x - here[0], y - here[1])
        return first + float(self.values[index]), float(later[0]), float(later[1])

    def _later(self, cells: int) -> IntArray:
        """Return the cell `cells` steps further on the way for each free cell; the last one at goals. Shape (n,)."""
        if cells not in self._kept:
            here = np.arange(len(self.toward))
            onward = np.where(self.toward >= 0, self.toward, here)
            for _ in range(cells):
                here = onward[here]
            self._kept[cells] = here
        return self._kept[cells]

    def path(self, start: FloatArray, tight: bool = True) -> FloatArray:
        """Return way points in [m] from the free cell nearest to `start` (2,) to a goal cell. Shape (k, 2).

        `tight` cuts corners wherever the robot still fits. HomeError when there is no way.
        """
        cell = int(self.space.nearest(np.asarray(start)[None])[0][0])
        if not np.isfinite(self.values[cell]):
            raise HomeError(f"no way leads from {np.round(start, 2).tolist()} to the goals")
        cells = [cell]
        while self.toward[cells[-1]] >= 0:
            cells.append(int(self.toward[cells[-1]]))
        points = self.space.centers[cells]
        return pull_tight(points, self.space) if tight else points


def pull_tight(points: FloatArray, space: FreeSpace) -> FloatArray:
    """Return a path without the waypoints that a straight line can skip. Shape (m, 2) -> (k, 2)."""
    kept, here = [0], 0
    while here < len(points) - 1:
        low, high = here + 1, len(points) - 1  # the next point is always in sight
        while low < high:  # sight need not be monotone: any point in sight will do, the farthest is not required
            middle = (low + high + 1) // 2
            low, high = (middle, high) if in_sight(points[here], points[middle], space) else (low, middle - 1)
        kept.append(low)
        here = low
    return points[kept]


def in_sight(start: FloatArray, end: FloatArray, space: FreeSpace) -> bool:
    """Return whether the robot can drive straight from one point to another, tested every half cell."""
    count = max(2, int(np.ceil(np.linalg.norm(end - start) / (0.5 * CELL))) + 1)
    along = np.linspace(0.0, 1.0, count)[:, None]
    return bool(space.is_free(start + along * (end - start)).all())


def free_space(apartment: Apartment, opened: Mapping[str, float] | None = None) -> FreeSpace:
    """Return the free space of an apartment, its drawers and doors at the positions `opened` (closed by default).

    The last ones asked for are kept and handed out again.
    """
    return _free_space(apartment, tuple(sorted((opened or {}).items())))


@lru_cache(maxsize=64)
def _free_space(apartment: Apartment, opened: tuple[tuple[str, float], ...]) -> FreeSpace:
    return FreeSpace.of(apartment.room, apartment_footprints(apartment, dict(opened)))


def _centers(low: FloatArray, cells: NDArray[Any]) -> FloatArray:
    """Return the centers of cells given as (rows, columns)."""
    return np.stack([low[0] + (cells[1] + 0.5) * CELL, low[1] + (cells[0] + 0.5) * CELL], axis=-1)
