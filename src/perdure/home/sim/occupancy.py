"""Where a round robot can stand and drive: footprints of furniture, free cells of a room, geodesic paths.

A set of footprints is one array of oriented rectangles, shape (n, 5): middle x, middle y, half length, half width in
[m], heading in [rad].

A cell of the grid is free when its middle keeps the robot's radius from every footprint and lies inside the room. That
test is exact (distances to rectangles, no rasterized obstacles). Cells are joined to their eight neighbors, diagonally
only when both cells beside the diagonal are free too. Between two cells that see each other, with d the straight
distance, the grid gives

    d <= grid distance <= d / cos(pi / 8) = 1.0824 d,

equal on the left along rows, columns and diagonals, on the right at 22.5 degrees. All footprints are convex, so a
segment of length s between two points at clearance r keeps at least sqrt(r^2 - s^2 / 4): 0.298 m for r = 0.3 m and
0.05 m cells.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from perdure.errors import PerdureError
from perdure.home.sim.arrays import BoolArray, FloatArray, IntArray
from perdure.home.sim.pieces import Apartment, Articulation, Piece, Pose, Solid


def clearance(points: FloatArray, rectangles: FloatArray) -> FloatArray:
    """Return distances in [m] of points (m, 2) to the nearest of some rectangles (n, 5), 0 inside one, inf for none."""
    best = np.full(len(points), np.inf)
    for x, y, half_x, half_y, yaw in rectangles:
        cos = np.cos(yaw)
        sin = np.sin(yaw)
        dx = points[:, 0] - x
        dy = points[:, 1] - y
        out_x = np.maximum(np.abs(cos * dx + sin * dy) - half_x, 0.0)
        out_y = np.maximum(np.abs(cos * dy - sin * dx) - half_y, 0.0)
        np.minimum(best, out_x * out_x + out_y * out_y, out=best)
    return np.asarray(np.sqrt(best))


def corners(rectangles: FloatArray) -> FloatArray:
    """Return the four corners of each rectangle, counter-clockwise. Shape (n, 4, 2)."""
    signs = np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])
    local = signs[None] * rectangles[:, None, 2:4]
    cos = np.cos(rectangles[:, 4, None])
    sin = np.sin(rectangles[:, 4, None])
    x = rectangles[:, 0, None] + cos * local[..., 0] - sin * local[..., 1]
    y = rectangles[:, 1, None] + sin * local[..., 0] + cos * local[..., 1]
    return np.stack([x, y], axis=-1)


def overlap(first: FloatArray, second: FloatArray, margin: float = 0.0) -> BoolArray:
    """Return which rectangles of two sets come closer than `margin` in the sense of separating axes. Shape (n, m).

    Two rectangles are apart when their shadows on the normal of one of their sides are at least `margin` apart; near
    corners that is up to sqrt(2) stricter than the distance between the shapes.
    """
    apart = np.zeros((len(first), len(second)), dtype=bool)
    a = corners(first)
    b = corners(second)
    for quarter in (0.0, np.pi / 2.0):
        # A pair is looked at along the sides of its first rectangle, then along those of its second.
        for axes in (_axes(first, quarter)[:, None], _axes(second, quarter)):
            pairs = np.broadcast_to(axes, (len(first), len(second), 2))
            shadow_a = np.einsum("ijk,ick->ijc", pairs, a)
            shadow_b = np.einsum("ijk,jck->ijc", pairs, b)
            gap = np.maximum(shadow_b.min(-1) - shadow_a.max(-1), shadow_a.min(-1) - shadow_b.max(-1))
            apart |= gap >= margin
    return ~apart


def _axes(rectangles: FloatArray, angle: float) -> FloatArray:
    """Return the directions at an angle in [rad] to the headings of rectangles. Shape (n, 2)."""
    return np.stack([np.cos(rectangles[:, 4] + angle), np.sin(rectangles[:, 4] + angle)], axis=-1)


def inside(points: FloatArray, polygon: Sequence[tuple[float, float]]) -> BoolArray:
    """Return which points lie inside a simple polygon (even-odd rule). Shape (m,)."""
    result = np.zeros(len(points), dtype=bool)
    x = points[:, 0]
    y = points[:, 1]
    for (x0, y0), (x1, y1) in zip(polygon, [*polygon[1:], polygon[0]], strict=True):
        if y0 == y1:
            continue
        crosses = (y0 > y) != (y1 > y)
        result ^= crosses & (x < x0 + (y - y0) * (x1 - x0) / (y1 - y0))
    return result


AJAR = 0.01
"""A drawer that is open by less in [m] does not stand out of its piece."""
CLIMB = 0.05
REACH_UP = 1.5
"""A solid is in the way when it reaches between these heights in [m] (M3's navigation mesh: climb 0.05, agent 1.5)."""


def footprints(
    piece: Piece, opened: Mapping[str, float] | None = None, low: float = CLIMB, high: float = REACH_UP
) -> FloatArray:
    """Return footprints of one piece's colliding solids, its drawers and doors at the positions `opened` by link name.

    Solids that end below `low` or begin above `high` in [m] are left out. Rectangles (x, y, half x, half y, yaw); those
    inside another of the same piece are left out. Shape (n, 5).
    """
    static = _rectangles(piece.pose, piece.solids, low, high)
    moving = [_moved(piece, moving, (opened or {}).get(moving.link, 0.0), low, high) for moving in piece.articulations]
    return _without_covered(np.concatenate([static, *moving]))


def apartment_footprints(
    apartment: Apartment, opened: Mapping[str, float] | None = None, low: float = CLIMB
) -> FloatArray:
    """Return footprints of all walls and pieces of an apartment, as `footprints`. Shape (n, 5)."""
    return np.concatenate([footprints(piece, opened, low) for piece in (*apartment.walls, *apartment.pieces)])


@lru_cache(maxsize=128)
def static_footprints(apartment: Apartment) -> FloatArray:
    """Return footprints of walls and of the static parts of pieces, as `footprints`. Shape (n, 5)."""
    bodies = (*apartment.walls, *apartment.pieces)
    return np.concatenate([_without_covered(_rectangles(p.pose, p.solids, CLIMB, REACH_UP)) for p in bodies])


def moving_footprints(apartment: Apartment, positions: FloatArray) -> FloatArray:
    """Return footprints of drawers and doors that are open by at least 1 cm; closed ones are within their piece.

    `positions` are in the order of the apartment's articulations, shape (links,). Shape (n, 5).
    """
    parts = [np.zeros((0, 5))]
    for moving, q in zip(apartment.articulations, positions.tolist(), strict=True):
        if abs(q) > AJAR or moving.kind == "hinge":
            parts.append(_moved(apartment.piece_of(moving.link), moving, q, CLIMB, REACH_UP))
    return np.concatenate(parts)


def _rectangles(pose: Pose, solids: Iterable[Solid], low: float, high: float, lift: float = 0.0) -> FloatArray:
    rows = [
        (s.center[0], s.center[1], s.half[0], s.half[1], pose.yaw)
        for s in solids
        if s.role != "look" and s.center[2] + s.half[2] + lift > low and s.center[2] - s.half[2] + lift < high
    ]
    return pose.to_room(np.array(rows, dtype=np.float64).reshape(-1, 5))


def _moved(piece: Piece, moving: Articulation, q: float, low: float, high: float) -> FloatArray:
    origin = moving.to_piece(np.zeros(3), q)
    turn = 0.0
    if moving.kind == "hinge":
        turn = q * moving.axis[2]
    x, y = piece.pose.to_room(origin[:2])
    return _rectangles(Pose(float(x), float(y), piece.pose.yaw + turn), moving.solids, low, high, float(origin[2]))


def _without_covered(rectangles: FloatArray) -> FloatArray:
    """Drop rectangles that lie inside another one with the same heading."""
    keep = np.ones(len(rectangles), dtype=bool)
    order = np.argsort(-rectangles[:, 2] * rectangles[:, 3], kind="stable")
    for rank, small in enumerate(order):
        for big in order[:rank]:
            if keep[big] and rectangles[big, 4] == rectangles[small, 4] and _covers(rectangles[big], rectangles[small]):
                keep[small] = False
                break
    return rectangles[keep]


def _covers(big: FloatArray, small: FloatArray) -> bool:
    cos = np.cos(big[4])
    sin = np.sin(big[4])
    dx = small[0] - big[0]
    dy = small[1] - big[1]
    out_x = abs(cos * dx + sin * dy) + small[2] - big[2]
    out_y = abs(cos * dy - sin * dx) + small[3] - big[3]
    return bool(max(out_x, out_y) <= 1e-9)


CELL = 0.05
"""Side of a cell in [m], as M3's navigation regions."""
RADIUS = 0.3
"""Radius of the robot in [m], as M3's navigation mesh (the Fetch's own base has 0.285)."""
_STEPS = ((0, 1), (1, 0), (1, 1), (1, -1))


@dataclass(frozen=True)
class FreeSpace:
    """The free cells of a room. Built by `free_space` or `FreeSpace.of`."""

    room: tuple[tuple[float, float], ...]
    rectangles: FloatArray
    """Footprints in the way. Shape (n, 5)."""
    free: BoolArray
    """Which cells are free; row along y, column along x. Shape (rows, columns)."""

    @staticmethod
    def of(room: Sequence[tuple[float, float]], rectangles: FloatArray) -> FreeSpace:
        """Return the free space of a room with footprints (n, 5) in it, its own walls among them; lengths in [m]."""
        low = np.min(room, axis=0)
        high = np.max(room, axis=0)
        columns, rows = np.ceil((high - low) / CELL - 1e-9).astype(int)
        points = _centers(low, np.indices((rows, columns)))  # (rows, columns, 2)
        free = inside(points.reshape(-1, 2), room).reshape(rows, columns)
        for rectangle in rectangles:  # each one only looks at the cells around it
            ring = (corners(rectangle[None])[0] - low) / CELL
            left, bottom = ring.min(axis=0) - RADIUS / CELL
            right, top = ring.max(axis=0) + RADIUS / CELL
            near = np.s_[max(int(bottom), 0) : max(int(top) + 1, 0), max(int(left), 0) : max(int(right) + 1, 0)]
            local = points[near].reshape(-1, 2)
            free[near] &= (clearance(local, rectangle[None]) >= RADIUS).reshape(free[near].shape)
        return FreeSpace(tuple(room), rectangles, free)

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
        return (clearance(points, self.rectangles) >= RADIUS) & inside(points, self.room)

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
        row = int((y - bottom) // CELL)
        column = int((x - left) // CELL)
        on_grid = 0 <= row < numbers.shape[0] and 0 <= column < numbers.shape[1]
        if on_grid and numbers[row, column] >= 0:
            return int(numbers[row, column])
        return int(self.nearest(np.array([[x, y]]))[0][0])

    def distances(self, goals: IntArray, cost: FloatArray | None = None) -> Geodesic:
        """Return geodesic distances from every free cell to the nearest of some goal cells, indices of shape (k,).

        `cost` is what a meter costs at each free cell, shape (n,); distances are then costs. 1 everywhere when None.
        """
        from scipy.sparse.csgraph import dijkstra

        if len(goals) == 0:
            raise PerdureError("geodesic distances need at least one goal cell")
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
            raise PerdureError("this room has no free cell at all")
        members = np.nonzero(self.island == 0)[0]
        return members, cKDTree(self.centers[members])

    @cached_property
    def _graph(self) -> Any:
        from scipy.sparse import csr_array

        free = self.free
        number = np.full((free.shape[0] + 2, free.shape[1] + 2), -1, dtype=np.int64)  # a border of -1
        number[1:-1, 1:-1][free] = np.arange(int(free.sum()))
        here = np.nonzero(number >= 0)
        starts = []
        ends = []
        lengths = []
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

    def ahead(self, x: float, y: float, cells: int) -> tuple[float, float, float]:
        """Return distance from a point, and the middle (x, y) of the cell so many cells on the way."""
        index = self.space.cell_at(x, y)
        here = self.space.centers[index]
        later = self.space.centers[self._later(cells)[index]]
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

    def path(self, start: FloatArray) -> FloatArray:
        """Return cell centers in [m] on the way from the free cell nearest to `start` (2,) to a goal cell. (k, 2).

        PerdureError when there is no way.
        """
        cell = int(self.space.nearest(np.asarray(start)[None])[0][0])
        if not np.isfinite(self.values[cell]):
            raise PerdureError(f"no way leads from {np.round(start, 2).tolist()} to the goals")
        cells = [cell]
        while self.toward[cells[-1]] >= 0:
            cells.append(int(self.toward[cells[-1]]))
        return self.space.centers[cells]


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
