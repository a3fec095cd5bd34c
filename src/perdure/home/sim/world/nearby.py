"""Exclusion of bodies from the contact search: furniture and sleeping objects far from the robot.

MuJoCo's broad phase looks at every body at every physics step; in a furnished room that is a quarter of the step. While
nothing is awake but the robot and what it holds, a body farther away than the robot reaches cannot be in a contact, so
it can be left out without changing one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from perdure.home.sim.arrays import BoolArray, FloatArray, IntArray

REACH = 1.6
"""Radius around the base in [m]: the gripper reaches 1.1, a held object 0.2 farther, the rest is margin."""
MOVED = 0.15
"""Distance in [m] after which the bodies near the base are determined again."""
SWING = 1.0
"""Largest displacement of a drawer or door from its compiled position in [m]."""


@dataclass(frozen=True, eq=False)
class Nearby:
    """Bounding boxes of the colliding bodies of a scene."""

    contype: NDArray[np.int32]
    """As compiled. Shape (bodies,)."""
    conaffinity: NDArray[np.int32]
    """As compiled. Shape (bodies,)."""
    low: FloatArray
    """Corners of boxes around static furniture and drawers, doors, as far as they move. Shape (bodies, 2)."""
    high: FloatArray
    """Shape (bodies, 2)."""
    fixed: BoolArray
    """Bodies whose box is known beforehand; the others are objects and the robot. Shape (bodies,)."""
    ours: BoolArray
    """The robot's bodies. Shape (bodies,)."""
    object_bodies: IntArray
    """Shape (objects,)."""

    @staticmethod
    def of(model: Any, object_bodies: IntArray) -> Nearby:
        """Measure a compiled `mujoco.MjModel`; the bodies `object_bodies` move freely. Shape (objects,)."""
        import mujoco

        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        root = int(model.body("robot").id)
        ours = np.asarray(model.body_rootid == root)
        fixed = ~ours
        fixed[object_bodies] = False
        low, high = np.full((model.nbody, 2), np.inf), np.full((model.nbody, 2), -np.inf)
        planes = model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE
        for geom in range(model.ngeom):
            body = int(model.geom_bodyid[geom])
            if not fixed[body]:
                continue
            turned = np.abs(data.geom_xmat[geom].reshape(3, 3)[:2])
            middle = data.geom_xpos[geom] + data.geom_xmat[geom].reshape(3, 3) @ model.geom_aabb[geom, :3]
            half = np.full(2, np.inf) if planes[geom] else turned @ model.geom_aabb[geom, 3:]
            low[body] = np.minimum(low[body], middle[:2] - half)
            high[body] = np.maximum(high[body], middle[:2] + half)
        moves = fixed & (model.body_weldid != 0)
        low[moves] -= SWING
        high[moves] += SWING
        return Nearby(
            contype=model.body_contype.copy(),
            conaffinity=model.body_conaffinity.copy(),
            low=low,
            high=high,
            fixed=fixed,
            ours=ours,
            object_bodies=object_bodies,
        )

    def around(self, base: FloatArray, objects: FloatArray) -> BoolArray:
        """Return which bodies robot or held object could touch before the base has gone `MOVED`. Shape (bodies,).

        Middles of the base, shape (2,), and of the objects, shape (objects, 2), in the room.
        """
        away = np.maximum(np.maximum(self.low - base, base - self.high), 0.0)
        near: BoolArray = (away * away).sum(axis=1) <= (REACH + MOVED) ** 2
        near |= self.ours
        if len(objects):
            apart = objects - base
            near[self.object_bodies] = (apart * apart).sum(axis=1) <= (REACH + MOVED) ** 2
        return near
