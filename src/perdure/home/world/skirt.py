"""What keeps the robot off the furniture as M3's navigation mesh does: nobody drives under a table.

M3's base moves on a mesh that keeps 0.3 m from everything in a room up to 1.5 m high, and slides along its edge. Here
bases are pushed by forces. Without more than the robot's own shapes one gets under a table until a leg stops it, where
wheels that do not slip sideways hold it for good.
"""

from __future__ import annotations

from typing import Any

from perdure.home.layouts.footprint import CLIMB, REACH_UP

RADIUS = 0.29
"""In [m]; M3's 0.3 less 1 cm for the push of the wheels, 5 mm more than the base itself."""
BIT = 4
"""Collision bit of the skirt: furniture and walls that do not move answer it, doors, drawers and objects do not."""
HIDDEN = 4
"""Its geom group."""


def meet_skirt(spec: Any) -> None:
    """Lets all furniture and walls that do not move meet the skirt. To be called before anything else is added."""
    for body in spec.bodies:
        if body.name != "world" and not body.joints:
            for geom in body.geoms:
                if geom.contype:
                    geom.conaffinity |= BIT


def add_skirt(spec: Any) -> None:
    """Puts the skirt around the base: an upright capsule that slides along what it meets without friction.

    No cylinder: at the corner of a box MuJoCo's general search for contacts finds normals that let it through (by 9 cm
    at 1.5 m/s), while a capsule and a box have an equation of their own. What is low meets the base itself.
    """
    import mujoco

    spec.body("robot").add_geom(
        name="robot/skirt",
        type=mujoco.mjtGeom.mjGEOM_CAPSULE,
        pos=(0.0, 0.0, 0.5 * (CLIMB + REACH_UP)),
        size=(RADIUS, 0.5 * (REACH_UP - CLIMB) - RADIUS, 0.0),
        contype=BIT,
        conaffinity=0,
        condim=1,
        priority=1,
        mass=0.0,
        group=HIDDEN,
        rgba=(0.0, 0.0, 0.0, 0.0),
    )
