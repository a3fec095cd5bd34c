"""The laser of the base: ranges to whatever stands in a plane just above the floor."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from perdure.home.world.lane import Lane

FloatArray = NDArray[np.float64]

BEAMS = 24
"""OURS: few enough for a small network; the Fetch's own scanner has 662."""
FIELD = np.radians(220.0)
"""Of view, as the Fetch's own scanner."""
LASER_RANGE = 5.0
"""OURS: ranges beyond are cut, in [m]."""
HEIGHT = 0.15
"""Of the plane above the floor in [m]. OURS: the Fetch's own (0.2878) passes over the shelf of a coffee table."""
NO_SCAN: FloatArray = np.full(BEAMS, LASER_RANGE)
_ANGLES = np.linspace(-0.5 * FIELD, 0.5 * FIELD, BEAMS)
_GROUPS = np.array([1, 1, 0, 1, 0, 0], dtype=np.uint8)
"""Groups that collide: solids, walls, hulls."""


def scan(lane: Lane) -> FloatArray:
    """Ranges from the robot's middle, from the right to the left. Shape (BEAMS,)."""
    import mujoco

    model, data, ray = lane.model, lane.data, mujoco.mj_ray
    x, y, yaw = lane.robot[:3]
    rays = np.stack([np.cos(_ANGLES + yaw), np.sin(_ANGLES + yaw), np.zeros(BEAMS)], axis=1)
    origin, geom = np.array([x, y, HEIGHT]), np.full(1, -1, dtype=np.int32)
    own_base = int(model.body("robot").id)  # the rays start inside it
    # Not mj_multiRay: it overlooks geoms on both sides of the -x direction (MuJoCo 3.17).
    ranges = np.array([ray(model, data, origin, each, _GROUPS, 1, own_base, geom) for each in rays])
    cut: FloatArray = np.where(ranges < 0.0, LASER_RANGE, np.minimum(ranges, LASER_RANGE))
    return cut
