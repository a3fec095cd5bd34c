"""Visual geometry of objects: bands, plates and prisms 0.3 mm outside the collision shape."""

from __future__ import annotations

import math
from dataclasses import dataclass

from perdure.home.sim.arrays import Vec3
from perdure.home.sim.objects.kinds import Kind
from perdure.home.sim.objects.shapes import CORNER, ConvexPart

Color = tuple[float, float, float, float]

PROUD = 3e-4
"""How far labels stand out in [m]."""


@dataclass(frozen=True)
class Visual:
    """A part of the visual geometry.

    Attributes:
        piece: Its shape; an `ellipsoid` too is a shape here.
        color: Red, green, blue and alpha in [0, 1].
        axis: Unit vector about which `piece.turn` turns it.
    """

    piece: ConvexPart
    color: Color
    axis: Vec3 = (0.0, 0.0, 1.0)


def band(kind: Kind, low: float, high: float, color: Color, out: float = 1.0) -> Visual:
    """Return a band around a can between two heights, as shares of the can's height; `out` is its distance outward."""
    radius, height = kind.half[0] + out * PROUD, kind.size[2]
    center = (0.0, 0.0, (0.5 * (low + high) - 0.5) * height)
    return Visual(ConvexPart("cylinder", (radius, radius, 0.5 * (high - low) * height), center), color)


def plate(
    kind: Kind,
    face: int,
    middle: tuple[float, float],
    half: tuple[float, float],
    color: Color,
    shape: str = "box",
    turn: float = 0.0,
    out: float = 1.0,
) -> Visual:
    """Return a label right through the object, so that it shows on both faces across an axis.

    Args:
        kind: The object.
        face: Axis of the faces, 0, 1 or 2.
        middle: Where on the face, in shares of its half sizes.
        half: Half sizes of the label in the same shares.
        color: Its color.
        shape: `box`, or across the z axis `cylinder`: a disc as wide as the first half size.
        turn: About the face's axis in [rad].
        out: Lays one label over another.
    """
    across = [axis for axis in range(3) if axis != face]
    size, center = [0.0] * 3, [0.0] * 3
    size[face] = kind.half[face] + out * PROUD
    for axis, at, extent in zip(across, middle, half, strict=True):
        center[axis], size[axis] = at * kind.half[axis], extent * kind.half[axis]
    normal = (float(face == 0), float(face == 1), float(face == 2))
    return Visual(
        ConvexPart(shape, (size[0], size[1], size[2]), (center[0], center[1], center[2]), turn), color, normal
    )


def rounded(kind: Kind, name: str, share: float, proud: float, color: Color) -> Visual:
    """Return a prism over a share of a rounded box's outline that stands out of its ends."""
    x, y, z = kind.half
    outline = rounded_rectangle(share * x, share * y, share * CORNER)
    corners = tuple((*corner, side * (z + proud)) for side in (-1, 1) for corner in outline)
    return Visual(ConvexPart("hull", name=f"{kind.name}/{name}", corners=corners), color)


def rounded_rectangle(x: float, y: float, radius: float) -> tuple[tuple[float, float], ...]:
    """Return the corners of a rectangle with half sizes x, y and rounded corners of three chords, counterclockwise."""
    corners = []
    for k, (sx, sy) in enumerate(((1, 1), (-1, 1), (-1, -1), (1, -1))):
        for step in range(4):
            angle = (k + step / 3.0) * math.pi / 2.0
            corners.append((sx * (x - radius) + radius * math.cos(angle), sy * (y - radius) + radius * math.sin(angle)))
    return tuple(corners)
