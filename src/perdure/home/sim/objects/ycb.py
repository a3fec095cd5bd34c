"""The YCB objects: their bounding boxes, and how to add them to a model."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from perdure.home.errors import HomeError
from perdure.home.sim.arrays import Vec3
from perdure.home.sim.objects.kinds import KINDS, Kind
from perdure.home.sim.objects.lathe import add_shell
from perdure.home.sim.objects.shapes import AppleShape, ConvexPart, moments, pieces
from perdure.home.sim.objects.visuals import COATS, visuals

TORSIONAL = 0.005
"""Torsional friction in [m], MuJoCo's default. It acts where `condim` is above 3."""
OBJECT_BIT = 8
"""Collision bit that objects share: objects collide with each other even when they ignore the robot."""
BOTH, SEEN, HIDDEN = 0, 2, 3
"""Geom groups: collides and is visible; visual only; collision only."""


@dataclass(frozen=True)
class YcbObjects:
    """The ten YCB objects.

    Attributes:
        visuals: Whether visual geometry is built (False makes a smaller model with the same physics).
        apple: What an apple is to the physics.
    """

    visuals: bool = True
    apple: AppleShape = "sphere"

    def kind(self, name: str) -> Kind:
        """Return a kind by its YCB name; HomeError when there is none of that name."""
        if name not in KINDS:
            raise HomeError(f"no object {name!r}; there are {', '.join(KINDS)}")
        return KINDS[name]

    def box(self, kind: str) -> tuple[Vec3, Vec3]:
        """Return lower and upper corner of an upright object's bounding box in its own frame, in [m]."""
        x, y, z = self.kind(kind).half
        return (-x, -y, -z), (x, y, z)

    def add(self, spec: Any, kind: str, name: str, position: Vec3, quaternion: tuple[float, ...]) -> None:
        """Add an object as a free body at a pose in the world, in [m] and (w, x, y, z), to an `mujoco.MjSpec`.

        The body has the object's name, its joint is `name/free`, its geoms are `name/0`, `name/1`, ...: those that
        collide first. Its frame is at the middle of its bounding box, z up when it stands upright.
        """
        what = self.kind(kind)
        body = spec.worldbody.add_body(name=name, pos=position, quat=quaternion)
        body.add_freejoint(name=f"{name}/free")
        body.mass, body.inertia, body.explicitinertial = what.mass, moments(what), True
        body.ipos, body.iquat = (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)  # unset, MuJoCo takes the body's own pose
        shell = self.visuals and what.shape in ("bowl", "sphere")
        hidden = self.visuals and what.shape != "box"
        for piece in pieces(what, self.apple):
            geom = _add_piece(spec, body, piece)
            geom.friction = (what.sliding, TORSIONAL, what.rolling if piece.rolls else 0.0)
            geom.condim = 6 if piece.rolls else 3
            geom.contype |= OBJECT_BIT
            geom.conaffinity |= OBJECT_BIT
            geom.group = HIDDEN if hidden else BOTH
            geom.rgba = COATS[kind]
        if self.visuals:
            seen = [add_shell(spec, body, what)] if shell else []
            for look in visuals(what):
                seen.append(_add_piece(spec, body, look.piece, look.axis))
                seen[-1].rgba = look.color
            for geom in seen:
                geom.contype, geom.conaffinity, geom.group = 0, 0, SEEN
        for k, geom in enumerate(body.geoms):
            geom.name, geom.mass = f"{name}/{k}", 0.0


def _add_piece(spec: Any, body: Any, piece: ConvexPart, axis: Vec3 = (0.0, 0.0, 1.0)) -> Any:
    import mujoco

    quaternion = (math.cos(piece.turn / 2.0), *(math.sin(piece.turn / 2.0) * part for part in axis))
    if piece.shape == "hull":
        if spec.mesh(piece.name) is None:
            spec.add_mesh(name=piece.name, uservert=np.array(piece.corners).ravel())
        return body.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=piece.name, quat=quaternion)
    x, _, z = piece.size
    size = {"cylinder": (x, z, 0.0), "sphere": (x, 0.0, 0.0)}.get(piece.shape, piece.size)
    shape = getattr(mujoco.mjtGeom, f"mjGEOM_{piece.shape.upper()}")
    return body.add_geom(type=shape, size=size, pos=piece.center, quat=quaternion)
