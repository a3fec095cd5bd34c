"""The 5 x 21 apartments: a macro layout, moved a little by a micro variation until everything fits.

A micro variation draws, from a generator seeded by (seed, macro, micro): which of the offered spots each piece takes,
and how far it is shifted and turned. A draw that fails one of the checks of `checks.py` is thrown away as a whole and
drawn again, so that the accepted ones are uniform among the good ones.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from functools import lru_cache
from itertools import count, islice

import numpy as np

from perdure.home.errors import HomeError
from perdure.home.sim.apartments import counter, fridge, furniture
from perdure.home.sim.apartments.checks import why_not
from perdure.home.sim.apartments.macros import Macro, Spot, macro_layout
from perdure.home.sim.apartments.piece import Apartment, Piece, Pose
from perdure.home.sim.apartments.walls import room_walls

MICROS = 21
"""Number of micro variations of each macro layout, as in ReplicaCAD."""
_DRAWS = 500
_KINDS = {
    "kitchen_counter": counter.kitchen_counter,
    "fridge": fridge.fridge,
    "table_01": furniture.table_01,
    "table_02": furniture.table_02,
    "tvstand": furniture.tvstand,
    "chair_01": furniture.chair_01,
    "sofa": furniture.sofa,
    "plant": furniture.plant,
    "lamp": furniture.lamp,
    "bookcase": furniture.bookcase,
    "rug": furniture.rug,
    "picture": furniture.picture,
}
THROWN_AWAY: Mapping[int, tuple[int, ...]] = {
    0: (5, 3, 7, 0, 10, 20, 1, 3, 1, 6, 1, 1, 1, 0, 1, 0, 5, 5, 0, 7, 0),
    1: (1, 0, 2, 0, 4, 2, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 1, 0, 0),
    2: (0, 0, 0, 4, 0, 0, 0, 1, 1, 2, 1, 1, 0, 3, 0, 0, 1, 0, 1, 1, 1),
    3: (0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 2, 0, 1, 0, 0, 0, 0),
    4: (0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 1, 0, 1),
}
"""Macro layout to the number of draws of each micro variation, with seed 0, that failed a check.

Kept because a check takes a tenth of a second. `tests/home/sim/apartments` draws and checks all of them again.
"""
SPLITS: dict[str, tuple[tuple[int, int], ...]] = {
    "train": tuple((macro, micro) for macro in range(4) for micro in range(16)),
    "val": tuple((macro, micro) for macro in range(4) for micro in range(16, 21)),
    "eval": tuple((4, micro) for micro in range(20)),
}
"""(macro, micro) of each split, as in M3 (`scripts/generate_episodes.sh`).

64 for training, 20 new configurations of the same layouts (val), 20 of a new layout (eval; M3 uses the first 20 of 21).
"""


@lru_cache(maxsize=128)
def make_apartment(macro: int, micro: int, seed: int = 0) -> Apartment:
    """Return macro layout 0 to 4 in micro variation 0 to 20, the same on every machine.

    Other seeds give other sets of 105 apartments; the published ones are those of seed 0.
    """
    drawn = drafts(macro, micro, seed)
    if seed == 0:
        return next(islice(drawn, THROWN_AWAY[macro][micro], None))
    for apartment in islice(drawn, _DRAWS):
        if why_not(apartment) is None:
            return apartment
    raise HomeError(f"no micro variation of macro {macro} fits: {_DRAWS} draws of micro {micro}, seed {seed} failed")


def drafts(macro: int, micro: int, seed: int) -> Iterator[Apartment]:
    """Return all draws of a micro variation, good or not, without an end; HomeError where there is no such one."""
    layout = macro_layout(macro)
    if not 0 <= micro < MICROS:
        raise HomeError(f"micro variation must be one of 0 to {MICROS - 1}, not {micro}")
    rng = np.random.Generator(np.random.PCG64([seed, macro, micro]))
    walls = room_walls(layout.room, layout.partitions)
    return (Apartment(macro, micro, seed, layout.room, walls, _draw_pieces(layout, rng)) for _ in count())


def _draw_pieces(layout: Macro, rng: np.random.Generator) -> tuple[Piece, ...]:
    pieces = []
    for offer in layout.offers:
        order = np.argsort(rng.random(len(offer.spots)), kind="stable")
        for name, choice in zip(offer.names, order, strict=False):
            pieces.append(_KINDS[offer.kind](name, _draw_pose(offer.spots[choice], rng)))
    return tuple(pieces)


def _draw_pose(spot: Spot, rng: np.random.Generator) -> Pose:
    """Return a pose near a spot; rounded, so that no machine's last bit can change an apartment."""
    shift_x, shift_y, turn = (2.0 * rng.random(3) - 1.0) * (*spot.shift, spot.turn_deg)
    place = Pose(spot.x, spot.y, math.radians(spot.yaw_deg)).to_room(np.array([shift_x, shift_y]))
    return Pose(round(float(place[0]), 4), round(float(place[1]), 4), round(math.radians(spot.yaw_deg + turn), 4))


def split_apartments(split: str) -> tuple[tuple[int, int], ...]:
    """Return the (macro, micro) pairs of `train`, `val` (cross-configuration) or `eval` (cross-layout)."""
    if split not in SPLITS:
        raise HomeError(f"split must be one of {', '.join(SPLITS)}, not {split!r}")
    return SPLITS[split]
