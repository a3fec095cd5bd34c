"""Settling of freshly placed objects, to check that they are stable."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from perdure.home.benchmark.episodes.surfaces import ObjectModels
from perdure.home.sim.apartments import Apartment, build_apartment
from perdure.home.sim.arrays import FloatArray
from perdure.home.sim.objects import Placement

SECONDS = 5.0
"""Time to settle in [s] (habitat-lab, `rearrange_generator.py`)."""
MOVED = 0.1
"""An object that moved farther than this in [m] was not stable (the same)."""
TIMESTEP = 1.0 / 240.0
"""Physics step in [s]."""


def settle(
    apartment: Apartment,
    opened: dict[str, float],
    placements: Sequence[Placement],
    models: ObjectModels,
    seconds: float = SECONDS,
) -> tuple[tuple[Placement, ...], FloatArray, FloatArray]:
    """Simulate objects in an apartment for some seconds.

    Args:
        apartment: Where they are.
        opened: Joint positions of doors and drawers by link name.
        placements: The objects.
        models: How the objects look to MuJoCo.
        seconds: For how long.

    Returns:
        The objects where they came to rest (rounded to 0.1 mm), how far each moved in [m] and how fast it still is in
        [m/s]. Shapes (objects,).
    """
    import mujoco

    spec = build_apartment(apartment, visuals=False)
    spec.option.timestep = TIMESTEP
    names = [f"object_{k}" for k in range(len(placements))]
    for name, placement in zip(names, placements, strict=True):
        models.add(spec, placement.kind, name, placement.position, placement.quaternion)
    model = spec.compile()
    data = mujoco.MjData(model)
    for link, q in opened.items():
        data.joint(apartment.articulation(link).joint).qpos = q
    mujoco.mj_step(model, data, nstep=round(seconds / TIMESTEP))
    mujoco.mj_forward(model, data)
    start = np.array([placement.position for placement in placements])
    bodies = [data.body(name) for name in names]
    moved = np.linalg.norm([body.xpos for body in bodies] - start, axis=1)
    speed = np.linalg.norm([body.cvel[3:] for body in bodies], axis=1)
    rested = (_rested(p, body.xpos, body.xquat) for p, body in zip(placements, bodies, strict=True))
    return tuple(rested), moved, speed


def _rested(placement: Placement, position: FloatArray, quaternion: FloatArray) -> Placement:
    x, y, z = (round(float(value), 4) for value in position)
    q0, q1, q2, q3 = (round(float(value), 5) + 0.0 for value in quaternion)
    return Placement(placement.kind, (x, y, z), (q0, q1, q2, q3), placement.receptacle)
