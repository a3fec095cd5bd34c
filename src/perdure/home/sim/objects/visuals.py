"""Visual geometry of the objects: a color and a few labels that make them recognizable."""

from __future__ import annotations

import math

from perdure.home.sim.objects.kinds import Kind
from perdure.home.sim.objects.paint import PROUD, Color, Visual, band, plate, rounded
from perdure.home.sim.objects.shapes import CORNER, ConvexPart

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
"""Color of a kind where it has no label: red, green, blue and alpha in [0, 1]."""
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


def visuals(kind: Kind) -> tuple[Visual, ...]:
    """Return the visual geometry of a kind: its coat where the collision shape differs, and its labels.

    The coats of bowl and apple are in `lathe`.
    """
    labels = _labels(kind)
    if kind.shape == "cylinder":
        return Visual(ConvexPart("cylinder", kind.half), COATS[kind.name]), *labels
    if kind.shape == "rounded_box":
        return rounded(kind, "coat", 1.0, 0.0, COATS[kind.name]), *labels
    return tuple(labels)


def _labels(kind: Kind) -> list[Visual]:
    """Return what is printed on an object or sticks out of it; an empty list for plain objects."""
    return [*_box_labels(kind), *_can_labels(kind), *_apple_parts(kind)]


def _box_labels(kind: Kind) -> list[Visual]:
    """Return the labels of a box."""
    match kind.name:
        case "003_cracker_box":  # red, a white field with a yellow stripe above, crackers below
            squares = [
                plate(kind, 0, (y, z), (0.20, 0.20 * kind.half[1] / kind.half[2]), _ORANGE, turn=turn, out=2.0)
                for y, z, turn in ((-0.45, -0.35, 0.3), (0.10, -0.55, -0.5), (0.50, -0.25, 0.9), (-0.35, -0.78, 0.1))
            ]
            return [
                plate(kind, 0, (0.0, 0.52), (0.74, 0.22), _WHITE),
                plate(kind, 0, (0.0, 0.52), (0.62, 0.09), _RED, out=2.0),
                plate(kind, 0, (0.0, 0.16), (1.0, 0.05), _YELLOW),
                plate(kind, 1, (0.0, 0.16), (1.0, 0.05), _YELLOW),
                *squares,
            ]
        case "004_sugar_box":  # yellow, a navy name on white, white ends
            return [
                plate(kind, 0, (0.0, 0.30), (1.0, 0.26), _WHITE),
                plate(kind, 1, (0.0, 0.30), (1.0, 0.26), _WHITE),
                plate(kind, 0, (0.0, 0.30), (0.72, 0.12), _NAVY, out=2.0),
                plate(kind, 0, (0.0, -0.45), (0.50, 0.07), _NAVY),
                plate(kind, 0, (0.0, -0.66), (0.32, 0.04), _RED),
                plate(kind, 2, (0.0, 0.0), (0.98, 0.98), _WHITE),
            ]
        case "008_pudding_box":  # brown, a white name, a cream pudding
            return [
                plate(kind, 2, (0.0, 0.50), (0.80, 0.22), _WHITE),
                plate(kind, 2, (0.0, 0.50), (0.62, 0.10), _RED, out=2.0),
                plate(kind, 2, (0.10, -0.40), (0.46, 0.36), _CREAM, "cylinder"),
                plate(kind, 1, (0.0, 0.0), (0.70, 0.40), _WHITE),
            ]
        case "009_gelatin_box":  # pink and red, a white name, a yellow spot
            return [
                plate(kind, 2, (0.0, -0.50), (1.005, 0.506), (0.95, 0.50, 0.58, 1.0)),
                plate(kind, 2, (0.0, 0.45), (0.80, 0.24), _WHITE),
                plate(kind, 2, (0.0, 0.45), (0.60, 0.11), _RED, out=2.0),
                plate(kind, 2, (-0.35, -0.45), (0.26, 0.30), _RED, "cylinder", out=2.0),
                plate(kind, 1, (0.0, 0.0), (0.70, 0.40), _WHITE),
            ]
    return []


def _can_labels(kind: Kind) -> list[Visual]:
    """Return labels and bare ends of a can."""
    radius, _, half = kind.half
    match kind.name:
        case "002_master_chef_can":  # blue with a white band and a red stripe in it, a pale lid
            lid = Visual(ConvexPart("cylinder", (0.96 * radius, 0.0, half + PROUD)), _CREAM)
            return [
                band(kind, 0.34, 0.62, _WHITE),
                band(kind, 0.44, 0.52, _RED, out=2.0),
                band(kind, 0.93, 1.001, _CREAM),
                lid,
            ]
        case "005_tomato_soup_can":  # red above, white below, a gold medal where they meet
            disc = ConvexPart("cylinder", (0.011, 0.0, radius + PROUD), turn=math.pi / 2.0)
            medal = Visual(disc, _GOLD, (0.0, 1.0, 0.0))
            return [band(kind, 0.02, 0.50, _WHITE), medal, *_tin_ends(kind)]
        case "007_tuna_fish_can":  # blue label, yellow stripe, bare ends
            return [band(kind, 0.42, 0.56, _YELLOW), *_tin_ends(kind)]
        case "010_potted_meat_can":  # blue, a yellow name, bare ends
            flat = 1.0 - CORNER / radius
            return [
                rounded(kind, "ends", 0.94, PROUD, _TIN),
                plate(kind, 1, (0.0, 0.18), (flat, 0.34), _YELLOW),
                plate(kind, 1, (0.0, 0.18), (0.8 * flat, 0.16), _NAVY, out=2.0),
                plate(kind, 1, (0.0, -0.60), (0.6 * flat, 0.08), _WHITE),
            ]
    return []


def _apple_parts(kind: Kind) -> list[Visual]:
    """Return a stem in the dent of the shell, and a leaf."""
    if kind.name != "013_apple":
        return []
    radius = kind.half[0]
    leaf = ConvexPart("ellipsoid", (0.015, 0.007, 0.0012), (0.013, 0.0, radius + 0.007), -0.12 * math.pi)
    return [
        Visual(ConvexPart("cylinder", (0.0016, 0.0, 0.013), (0.0, 0.0, radius)), _BARK),
        Visual(leaf, _GREEN, (0.0, 1.0, 0.0)),
    ]


def _tin_ends(kind: Kind) -> list[Visual]:
    """Return the bare ends of a tin, and its two rims."""
    radius, half = kind.half[0], kind.half[2]
    ends = Visual(ConvexPart("cylinder", (0.94 * radius, 0.0, half + PROUD / 2.0)), _TIN)
    rim, over = 0.0025 / kind.size[2], PROUD / kind.size[2]
    return [ends, band(kind, -over, rim, _TIN), band(kind, 1.0 - rim, 1.0 + over, _TIN)]
