"""Walls of an apartment hidden, so that a camera outside sees into the room."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from perdure.home.sim.apartments.piece import Apartment


def cut_away(model: Any, apartment: Apartment, eye: NDArray[np.float64]) -> None:
    """Makes the walls (and the pictures on them) between a camera and the room invisible, as in a doll's house.

    Args:
        model: A compiled MuJoCo model of the apartment; colors are changed in place.
        apartment: The apartment it was built from.
        eye: Position of the camera in the room. Shape (3,).
    """
    for piece in (*apartment.walls, *apartment.pieces):
        if piece.kind not in ("wall", "picture") or piece.name.startswith("partition"):
            continue
        facing = piece.pose.yaw + (np.pi / 2.0 if piece.kind == "wall" else 0.0)  # where its room side looks
        if (eye[0] - piece.pose.x) * np.cos(facing) + (eye[1] - piece.pose.y) * np.sin(facing) < 0.0:
            for solid in piece.solids:
                model.geom(f"{piece.name}/{solid.name}").rgba[3] = 0.0
