"""How the objects look: a coat of paint and a few labels by which a stranger recognises them.

Labels are thin plates and bands that stand 0.3 mm out of what collides and take part in nothing.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from perdure.home.objects.kinds import Kind, Vec3
from perdure.home.objects.shapes import CORNER, Piece

Color = tuple[float, float, float, float]

PROUD = 3e-4
"""How far labels stand out in [m]."""
COATS: dict[str, Color] = {
    "002_master_chef_can": (0.08, 0.17, 0.50, 1.0),
    "003_cracker_box": (0.76, 0.08, 0.09, 1.0),
    "004_sugar_box": (0.97, 0.80, 0.10, 1.0),
    "005_tomato_soup_can": (0.80, 0.07, 0.09, 1.0),
    "007_tuna_fish_can": (0.12, 0.42, 0.66, 1.0),
    "008_pudding_box": (0.36, 0.20, 0.12, 1.0),
    "009_gelatin_box": (0.84, 0.16, 0.30, 1.0),
    "010_potted_meat_can": (0.10, 0.22, 0.56, 1.0),
    "024_bowl": (0.74, 0.10, 0.09, 1.0),
    "013_apple": (0.74, 0.09, 0.10, 1.0),
}
"""Colour of what collides, by kind: red, green, blue and alpha in [0, 1]."""
_TIN: Color = (0.74, 0.75, 0.77, 1.0)
_WHITE: Color = (0.96, 0.95, 0.92, 1.0)
_YELLOW: Color = (0.98, 0.80, 0.16, 1.0)
_ORANGE: Color = (0.93, 0.56, 0.14, 1.0)
_NAVY: Color = (0.08, 0.12, 0.42, 1.0)
_RED: Color = (0.80, 0.07, 0.09, 1.0)
_GOLD: Color = (0.80, 0.62, 0.24, 1.0)
_CREAM: Color = (0.93, 0.84, 0.68, 1.0)
_BARK: Color = (0.30, 0.20, 0.11, 1.0)
_GREEN: Color = (0.25, 0.48, 0.14, 1.0)


@dataclass(frozen=True)
class Look:
    """A part that is only seen.

    Attributes:
        piece: Its shape; an `ellipsoid` too is a shape here.
        color: Red, green, blue and alpha in [0, 1].
        axis: Unit vector about which `piece.turn` turns it.
    """

    piece: Piece
    color: Color
    axis: Vec3 = (0.0, 0.0, 1.0)


def looks(kind: Kind) -> tuple[Look, ...]:
    """The parts of a kind that are only seen; the shells of bowl and apple are in `lathe`."""
    makers = {
        "002_master_chef_can": _coffee,
        "003_cracker_box": _crackers,
        "004_sugar_box": _sugar,
        "005_tomato_soup_can": _soup,
        "007_tuna_fish_can": _tuna,
        "008_pudding_box": _pudding,
        "009_gelatin_box": _gelatin,
        "010_potted_meat_can": _meat,
        "013_apple": _apple,
    }
    return tuple(makers[kind.name](kind)) if kind.name in makers else ()


def _band(kind: Kind, low: float, high: float, color: Color, out: float = 1.0) -> Look:
    """A band around a can between two heights, in shares of its own from the bottom; `out` lays one over another."""
    radius, height = kind.half[0] + out * PROUD, kind.size[2]
    center = (0.0, 0.0, (0.5 * (low + high) - 0.5) * height)
    return Look(Piece("cylinder", (radius, radius, 0.5 * (high - low) * height), center), color)


def _tin_ends(kind: Kind) -> list[Look]:
    """The bare ends of a tin, and its two rims."""
    radius, half = kind.half[0], kind.half[2]
    ends = Look(Piece("cylinder", (0.94 * radius, 0.0, half + PROUD / 2.0)), _TIN)
    rim, over = 0.0025 / kind.size[2], PROUD / kind.size[2]
    return [ends, _band(kind, -over, rim, _TIN), _band(kind, 1.0 - rim, 1.0 + over, _TIN)]


def _plate(
    kind: Kind,
    face: int,
    middle: tuple[float, float],
    half: tuple[float, float],
    color: Color,
    shape: str = "box",
    turn: float = 0.0,
    out: float = 1.0,
) -> Look:
    """A label right through the object, so that it shows on both faces across an axis.

    Args:
        kind: The object.
        face: Axis of the faces, 0, 1 or 2.
        middle: Where on the face, in shares of its half sizes.
        half: Half sizes of the label in the same shares.
        color: Its colour.
        shape: `box` or `ellipsoid`.
        turn: About the face's axis in [rad].
        out: Lays one label over another.
    """
    across = [axis for axis in range(3) if axis != face]
    size, center = [0.0] * 3, [0.0] * 3
    size[face] = kind.half[face] + out * PROUD
    for axis, at, extent in zip(across, middle, half, strict=True):
        center[axis], size[axis] = at * kind.half[axis], extent * kind.half[axis]
    normal = (float(face == 0), float(face == 1), float(face == 2))
    return Look(Piece(shape, (size[0], size[1], size[2]), (center[0], center[1], center[2]), turn), color, normal)


def _crackers(kind: Kind) -> list[Look]:
    """Red, a white field with a yellow stripe above, crackers below."""
    squares = [
        _plate(kind, 0, (y, z), (0.20, 0.20 * kind.half[1] / kind.half[2]), _ORANGE, turn=turn, out=2.0)
        for y, z, turn in ((-0.45, -0.35, 0.3), (0.10, -0.55, -0.5), (0.50, -0.25, 0.9), (-0.35, -0.78, 0.1))
    ]
    return [
        _plate(kind, 0, (0.0, 0.52), (0.74, 0.22), _WHITE),
        _plate(kind, 0, (0.0, 0.52), (0.62, 0.09), _RED, out=2.0),
        _plate(kind, 0, (0.0, 0.16), (1.0, 0.05), _YELLOW),
        _plate(kind, 1, (0.0, 0.16), (1.0, 0.05), _YELLOW),
        *squares,
    ]


def _sugar(kind: Kind) -> list[Look]:
    """Yellow, a navy name on white, white ends."""
    return [
        _plate(kind, 0, (0.0, 0.30), (1.0, 0.26), _WHITE),
        _plate(kind, 1, (0.0, 0.30), (1.0, 0.26), _WHITE),
        _plate(kind, 0, (0.0, 0.30), (0.72, 0.12), _NAVY, out=2.0),
        _plate(kind, 0, (0.0, -0.45), (0.50, 0.07), _NAVY),
        _plate(kind, 0, (0.0, -0.66), (0.32, 0.04), _RED),
        _plate(kind, 2, (0.0, 0.0), (0.98, 0.98), _WHITE),
    ]


def _soup(kind: Kind) -> list[Look]:
    """Red above, white below, a gold medal where they meet."""
    disc = Piece("cylinder", (0.011, 0.0, kind.half[0] + PROUD), turn=math.pi / 2.0)
    medal = Look(disc, _GOLD, (0.0, 1.0, 0.0))
    return [_band(kind, 0.02, 0.50, _WHITE), medal, *_tin_ends(kind)]


def _coffee(kind: Kind) -> list[Look]:
    """Blue with a white band and a red stripe in it, a pale lid."""
    lid = Look(Piece("cylinder", (0.96 * kind.half[0], 0.0, kind.half[2] + PROUD)), _CREAM)
    return [
        _band(kind, 0.34, 0.62, _WHITE),
        _band(kind, 0.44, 0.52, _RED, out=2.0),
        _band(kind, 0.93, 1.001, _CREAM),
        lid,
    ]


def _tuna(kind: Kind) -> list[Look]:
    """Blue label, yellow stripe, bare ends."""
    return [_band(kind, 0.42, 0.56, _YELLOW), *_tin_ends(kind)]


def _pudding(kind: Kind) -> list[Look]:
    """Brown, a white name, a cream pudding."""
    return [
        _plate(kind, 2, (0.0, 0.50), (0.80, 0.22), _WHITE),
        _plate(kind, 2, (0.0, 0.50), (0.62, 0.10), _RED, out=2.0),
        _plate(kind, 2, (0.10, -0.40), (0.46, 0.36), _CREAM, "cylinder"),
        _plate(kind, 1, (0.0, 0.0), (0.70, 0.40), _WHITE),
    ]


def _gelatin(kind: Kind) -> list[Look]:
    """Pink and red, a white name, a yellow spot."""
    return [
        _plate(kind, 2, (0.0, -0.50), (1.005, 0.506), (0.95, 0.50, 0.58, 1.0)),
        _plate(kind, 2, (0.0, 0.45), (0.80, 0.24), _WHITE),
        _plate(kind, 2, (0.0, 0.45), (0.60, 0.11), _RED, out=2.0),
        _plate(kind, 2, (-0.35, -0.45), (0.26, 0.30), _RED, "cylinder", out=2.0),
        _plate(kind, 1, (0.0, 0.0), (0.70, 0.40), _WHITE),
    ]


def _meat(kind: Kind) -> list[Look]:
    """Blue, a yellow name, bare ends."""
    x, y, z = kind.half
    corners = tuple(
        (*corner, side * (z + PROUD))
        for side in (-1, 1)
        for corner in rounded_rectangle(0.95 * x, 0.93 * y, 0.9 * CORNER)
    )
    flat = 1.0 - CORNER / x
    return [
        Look(Piece("hull", name=f"{kind.name}/ends", corners=corners), _TIN),
        _plate(kind, 1, (0.0, 0.18), (flat, 0.34), _YELLOW),
        _plate(kind, 1, (0.0, 0.18), (0.8 * flat, 0.16), _NAVY, out=2.0),
        _plate(kind, 1, (0.0, -0.60), (0.6 * flat, 0.08), _WHITE),
    ]


def _apple(kind: Kind) -> list[Look]:
    """A stem in the dent of the shell, and a leaf."""
    radius = kind.half[0]
    leaf = Piece("ellipsoid", (0.015, 0.007, 0.0012), (0.013, 0.0, radius + 0.007), -0.12 * math.pi)
    return [
        Look(Piece("cylinder", (0.0016, 0.0, 0.013), (0.0, 0.0, radius)), _BARK),
        Look(leaf, _GREEN, (0.0, 1.0, 0.0)),
    ]


def rounded_rectangle(x: float, y: float, radius: float) -> tuple[tuple[float, float], ...]:
    """Corners of a rectangle of half sizes x, y whose corners are quarter circles of three chords, counterclockwise."""
    corners = []
    for k, (sx, sy) in enumerate(((1, 1), (-1, 1), (-1, -1), (1, -1))):
        for step in range(4):
            angle = (k + step / 3.0) * math.pi / 2.0
            corners.append((sx * (x - radius) + radius * math.cos(angle), sy * (y - radius) + radius * math.sin(angle)))
    return tuple(corners)
