"""Visual geometry of bowl and apple: surfaces of revolution around the collision shapes."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from perdure.home.sim.arrays import FloatArray
from perdure.home.sim.objects.kinds import Kind
from perdure.home.sim.objects.shapes import FLOOR, FOOT, WALL, cap_radius
from perdure.home.sim.objects.visuals import COATS

AROUND, UP = 40, 8
"""Corners around a shell, and along each side of the bowl's wall."""


def add_shell(spec: Any, body: Any, kind: Kind) -> Any:
    """Add the round shell of a bowl or an apple to a body; its mesh is made once in a specification.

    Returns:
        The geom.
    """
    import mujoco

    name = f"{kind.name}/shell"
    if spec.mesh(name) is None:
        corners, faces = turned(bowl_profile(kind) if kind.shape == "bowl" else apple_profile(kind))
        spec.add_mesh(
            name=name,
            uservert=corners.ravel(),
            userface=faces.ravel(),
            inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
        )
    return body.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=name, rgba=COATS[kind.name])


def bowl_profile(kind: Kind) -> FloatArray:
    """Return radius and height in [m] from the middle of the foot over the rim to the middle of the floor: (n, 2)."""
    height, radius = kind.size[2], cap_radius(kind)
    up = np.linspace(0.0, height, UP + 1)
    outer = np.sqrt(2.0 * radius * up - up**2)
    keep = outer > FOOT
    outer, up = outer[keep], up[keep]
    lifted = FLOOR + (up - up[0]) * (height - FLOOR) / (height - up[0])
    across = np.concatenate([[0.0, FOOT, FOOT], outer, outer[::-1] - WALL, [0.0]])
    along = np.concatenate([[0.0, 0.0, up[0] / 2.0], up, lifted[::-1], [FLOOR]])
    return np.stack([across, along - height / 2.0], axis=-1)


def apple_profile(kind: Kind) -> FloatArray:
    """Return radius and height in [m] from the blossom to the stem: a circle with a dent at each end. Shape (n, 2)."""
    angle = np.linspace(0.0, np.pi, 4 * UP + 1)
    dents = 0.10 * np.exp(-((angle / 0.28) ** 2)) + 0.24 * np.exp(-(((np.pi - angle) / 0.34) ** 2))
    out = kind.half[0] * (1.0 - dents - 0.05 * np.cos(angle / 2.0) ** 4)
    return np.stack([np.abs(out * np.sin(angle)), -out * np.cos(angle)], axis=-1)


def turned(profile: FloatArray) -> tuple[FloatArray, NDArray[np.int32]]:
    """Return corners and triangles of a profile (radius, height) turned about the z axis, its two ends on the axis.

    The profile (n, 2) lists the outside first. Corners have shape (corners, 3), triangles, counterclockwise from
    outside, shape (triangles, 3).
    """
    angle = 2.0 * np.pi * np.arange(AROUND) / AROUND
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    rings = [np.column_stack([r * circle, np.full(AROUND, z)]) for r, z in profile[1:-1]]
    corners = np.concatenate([*rings, [[0.0, 0.0, profile[0, 1]], [0.0, 0.0, profile[-1, 1]]]])
    here = np.arange(AROUND)
    after = (here + 1) % AROUND
    first, last, count = len(corners) - 2, len(corners) - 1, len(rings)
    faces = [np.column_stack([after, here, np.full(AROUND, first)])]
    for ring in range(count - 1):
        a, b = ring * AROUND, (ring + 1) * AROUND
        faces.append(np.column_stack([a + here, a + after, b + after]))
        faces.append(np.column_stack([a + here, b + after, b + here]))
    end = (count - 1) * AROUND
    faces.append(np.column_stack([end + here, end + after, np.full(AROUND, last)]))
    return corners, np.concatenate(faces).astype(np.int32)
