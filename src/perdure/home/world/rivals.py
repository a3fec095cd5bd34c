"""What a grasp might take instead of the target: the objects next to it, and handles.

The magic grasp takes the nearest handle within reach, else the nearest object, so a robot that picks must know them;
its head camera would show them.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from perdure.home.world.lane import Lane

FloatArray = NDArray[np.float64]

RIVALS = 2
"""So many of the nearest are told of."""
NEIGHBOURHOOD = 0.5
"""How near the target an object must be to be told of, in [m]."""


class Rivals(NamedTuple):
    """What stands around one lane's target."""

    from_object: FloatArray
    """From the target to the nearest other objects, in the room; 0 where there is none. Shape (RIVALS, 3)."""
    distance: float
    """From the gripper point to the nearest other object in [m], inf without one."""
    handle_distance: float
    """From the gripper point to the nearest handle in [m], inf without one."""


NO_RIVALS = Rivals(np.zeros((RIVALS, 3)), np.inf, np.inf)


def look_around(lane: Lane, target: int, gripper: FloatArray) -> Rivals:
    """Looks around a target.

    Args:
        lane: Where.
        target: Number of the object; one that the scene does not have has no rivals but handles.
        gripper: The gripper point in the room. Shape (3,).
    """
    scene, from_object, distance, handle = lane.scene, np.zeros((RIVALS, 3)), np.inf, np.inf
    if scene.links:
        handle = float(_lengths(scene.handles.at(lane.links) - gripper).min())
    if 0 <= target < len(scene.placements) and len(scene.placements) > 1:
        middles = lane.qpos[scene.middles]
        others = np.delete(middles, target, axis=0)
        distance = float(_lengths(others - gripper).min())
        apart = others - middles[target]
        away = _lengths(apart)
        nearest = np.argsort(away, kind="stable")[:RIVALS]
        nearest = nearest[away[nearest] <= NEIGHBOURHOOD]
        from_object[: len(nearest)] = apart[nearest]
    return Rivals(from_object, distance, handle)


def _lengths(vectors: FloatArray) -> FloatArray:
    lengths: FloatArray = np.sqrt((vectors * vectors).sum(axis=1))
    return lengths
