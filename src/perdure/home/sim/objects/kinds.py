"""The ten YCB objects of the benchmark: sizes, masses, shapes and friction."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from perdure.home.sim.arrays import Vec3

Shape = Literal["box", "rounded_box", "cylinder", "bowl", "sphere"]

SLIDING = 0.3
"""Sliding friction of every object: MS-HAB's static and dynamic friction. Bullet multiplies an object's 0.5 by the
world's 0.4, which is 0.2; MuJoCo takes the larger of a pair, and furniture has 0.2, so that the object decides."""
CAN_ROLLING = 5e-4
"""Rolling friction of the cans in [m], OURS: a tin on a table, 1.0 to 1.5 % of its weight."""
APPLE_ROLLING = 1.2e-3
"""Rolling friction of the apple in [m], OURS: 3.2 % of its weight, as it is not round."""

_SCAN = "size: scan, BOP's YCB-V model table; mass: Calli et al. 2015"
_MEASURED = "size and mass: measured, Calli et al. 2015"
_TABLE = "size: measured, Calli et al. 2015 (the scan lies askew in its frame); mass: the same"


@dataclass(frozen=True)
class Kind:
    """One object of the YCB set (Calli et al., *Benchmarking in Manipulation Research*, IEEE RAM 2015).

    Attributes:
        name: YCB name, number first.
        size: Full size of the bounding box in [m], standing upright with z up.
        mass: In [kg].
        shape: What it is to the physics.
        sliding: Sliding friction.
        rolling: Rolling friction in [m]: the lever arm of the weight that resists rolling; 0 if it has no round side.
        source: Where size and mass come from.
    """

    name: str
    size: Vec3
    mass: float
    shape: Shape
    source: str
    sliding: float = SLIDING
    rolling: float = 0.0

    @property
    def cylinder(self) -> bool:
        """Whether it is an upright cylinder."""
        return self.shape == "cylinder"

    @property
    def half(self) -> Vec3:
        """Half of the size in [m]."""
        x, y, z = self.size
        return x / 2.0, y / 2.0, z / 2.0


KINDS: dict[str, Kind] = {
    kind.name: kind
    for kind in (
        Kind("002_master_chef_can", (0.1024, 0.1024, 0.1401), 0.414, "cylinder", _SCAN, rolling=CAN_ROLLING),
        Kind("003_cracker_box", (0.0717, 0.1640, 0.2135), 0.411, "box", _SCAN),
        Kind("004_sugar_box", (0.0495, 0.0940, 0.1760), 0.514, "box", _SCAN),
        Kind("005_tomato_soup_can", (0.0679, 0.0679, 0.1020), 0.349, "cylinder", _SCAN, rolling=CAN_ROLLING),
        Kind("007_tuna_fish_can", (0.0856, 0.0856, 0.0335), 0.171, "cylinder", _SCAN, rolling=CAN_ROLLING),
        Kind("008_pudding_box", (0.1100, 0.0890, 0.0350), 0.187, "box", _TABLE),
        Kind("009_gelatin_box", (0.0850, 0.0730, 0.0280), 0.097, "box", _TABLE),
        Kind("010_potted_meat_can", (0.1021, 0.0603, 0.0836), 0.370, "rounded_box", _SCAN),
        Kind("024_bowl", (0.1614, 0.1614, 0.0550), 0.147, "bowl", _SCAN),
        Kind("013_apple", (0.0750, 0.0750, 0.0750), 0.068, "sphere", _MEASURED, rolling=APPLE_ROLLING),
    )
}
"""The ten kinds by their YCB name."""


def short_name(kind: str) -> str:
    """Return a YCB name without its number: `005_tomato_soup_can` is "tomato soup can"."""
    number, _, words = kind.partition("_")
    return (words if number.isdigit() and words else kind).replace("_", " ")
