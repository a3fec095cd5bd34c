"""Plane geometry on oriented rectangles: the footprints that a round robot must stay away from.

A set of rectangles is one array of shape (n, 5): middle x, middle y, half length, half width in [m], heading in [rad].
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from perdure.home.sim.arrays import BoolArray, FloatArray


def clearance(points: FloatArray, rectangles: FloatArray) -> FloatArray:
    """Return distances in [m] of points (m, 2) to the nearest of some rectangles (n, 5), 0 inside one, inf for none."""
    best = np.full(len(points), np.inf)
    for x, y, half_x, half_y, yaw in rectangles:
        cos, sin = np.cos(yaw), np.sin(yaw)
        dx, dy = points[:, 0] - x, points[:, 1] - y
        out_x = np.maximum(np.abs(cos * dx + sin * dy) - half_x, 0.0)
        out_y = np.maximum(np.abs(cos * dy - sin * dx) - half_y, 0.0)
        np.minimum(best, out_x * out_x + out_y * out_y, out=best)
    return np.asarray(np.sqrt(best))


def corners(rectangles: FloatArray) -> FloatArray:
    """Return the four corners of each rectangle, counter-clockwise. Shape (n, 4, 2)."""
    signs = np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])
    local = signs[None] * rectangles[:, None, 2:4]
    cos, sin = np.cos(rectangles[:, 4, None]), np.sin(rectangles[:, 4, None])
    x = rectangles[:, 0, None] + cos * local[..., 0] - sin * local[..., 1]
    y = rectangles[:, 1, None] + sin * local[..., 0] + cos * local[..., 1]
    return np.stack([x, y], axis=-1)


def overlap(first: FloatArray, second: FloatArray, margin: float = 0.0) -> BoolArray:
    """Return which rectangles of two sets come closer than `margin` in the sense of separating axes. Shape (n, m).

    Two rectangles are apart when their shadows on the normal of one of their sides are at least `margin` apart; near
    corners that is up to sqrt(2) stricter than the distance between the shapes.
    """
    apart = np.zeros((len(first), len(second)), dtype=bool)
    a, b = corners(first), corners(second)
    for yaws, own_first in ((first[:, 4], True), (second[:, 4], False)):
        for quarter in (0.0, np.pi / 2.0):
            axes = np.stack([np.cos(yaws + quarter), np.sin(yaws + quarter)], axis=-1)
            pairs = axes[:, None, :] if own_first else axes[None, :, :]
            pairs = np.broadcast_to(pairs, (len(first), len(second), 2))
            shadow_a = np.einsum("ijk,ick->ijc", pairs, a)
            shadow_b = np.einsum("ijk,jck->ijc", pairs, b)
            gap = np.maximum(shadow_b.min(-1) - shadow_a.max(-1), shadow_a.min(-1) - shadow_b.max(-1))
            apart |= gap >= margin
    return ~apart


def inside(points: FloatArray, polygon: Sequence[tuple[float, float]]) -> BoolArray:
    """Return which points lie inside a simple polygon (even-odd rule). Shape (m,)."""
    result = np.zeros(len(points), dtype=bool)
    x, y = points[:, 0], points[:, 1]
    closed = [*polygon[1:], polygon[0]]
    for (x0, y0), (x1, y1) in zip(polygon, closed, strict=True):
        if y0 == y1:
            continue
        crosses = (y0 > y) != (y1 > y)
        result ^= crosses & (x < x0 + (y - y0) * (x1 - x0) / (y1 - y0))
    return result


def area(polygon: Sequence[tuple[float, float]]) -> float:
    """Return signed area of a simple polygon in [m^2], positive when its corners run counter-clockwise."""
    corner = np.asarray(polygon)
    after = np.roll(corner, -1, axis=0)
    return float(0.5 * np.sum(corner[:, 0] * after[:, 1] - after[:, 0] * corner[:, 1]))
