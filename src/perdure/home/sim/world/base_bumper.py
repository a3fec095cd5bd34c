"""The base bumper: it keeps the robot off furniture and out from under tables, like the navigation mesh of M3.

M3's base moves on a mesh that keeps 0.3 m from everything in a room up to 1.5 m high, and slides along its edge. Here
forces move the base. With only its own collision shapes the robot can drive under a table and get stuck against a leg,
because its wheels do not slip sideways.
"""

from __future__ import annotations

from typing import Any

from perdure.home.sim.apartments import Apartment
from perdure.home.sim.apartments.footprint import CLIMB, REACH_UP
from perdure.home.sim.robot.fetch import HIDDEN

RADIUS = 0.29
"""In [m]; M3's 0.3 less 1 cm for the push of the wheels, 5 mm more than the base itself."""
BIT = 4
"""Its collision bit; 1 and 2 are the robot's own (`perdure.home.sim.robot.shapes`)."""


def add_base_bumper(spec: Any, apartment: Apartment) -> None:
    """Add the base bumper to a specification with apartment and robot. Drawers and doors do not collide with it.

    It is an upright capsule without friction. A cylinder will not do: at the corner of a box the general search for
    contacts of MuJoCo 3.17 finds normals that let it through, while a capsule and a box have an equation of their own.
    What is low meets the base itself.
    """
    import mujoco

    for piece in (*apartment.walls, *apartment.pieces):
        for geom in spec.body(piece.name).geoms:  # those of drawers and doors belong to bodies of their own
            if geom.contype:
                geom.conaffinity |= BIT
    spec.body("robot").add_geom(
        name="robot/base_bumper",
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
