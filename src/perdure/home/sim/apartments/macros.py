"""The five macro layouts: the rooms, and where their furniture stands before a micro variation moves it (all OURS).

A `Spot` is one possible place of a piece. A micro variation shifts the piece along its own x and y, and turns it. The
spots for one kind are an offer: a micro variation uses as many of them as there are names.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from perdure.home.errors import HomeError

MACROS = 5
"""Number of macro layouts, as in ReplicaCAD."""


@dataclass(frozen=True)
class Spot:
    """A place for a piece: pose in [m] and [degrees], and the largest shift along x, y and turn around it."""

    x: float
    y: float
    yaw_deg: float
    shift: tuple[float, float] = (0.0, 0.0)
    turn_deg: float = 0.0


@dataclass(frozen=True)
class Offer:
    """Which pieces to place (names) on which of the spots."""

    kind: str
    names: tuple[str, ...]
    spots: tuple[Spot, ...]


@dataclass(frozen=True)
class Macro:
    """One macro layout: the floor's corners counter-clockwise, partition walls (x0, y0, x1, y1), and the offers."""

    room: tuple[tuple[float, float], ...]
    partitions: tuple[tuple[float, float, float, float], ...]
    offers: tuple[Offer, ...]


_ALONG = (0.0, 0.20)
"""Shift along a wall only."""
_FREE = (0.15, 0.15)
_ANY_WAY = (0.0, (0.04, 0.04), 180.0)
"""Yaw, shift and turn of round pieces, of which only x and y are given."""
_NAMES = {"chair_01": ("chair_01_0", "chair_01_1"), "plant": ("plant_0", "plant_1")}
"""Names of the kinds that come in several pieces."""


def _macro(
    room: tuple[tuple[float, float], ...],
    *,
    partitions: tuple[tuple[float, float, float, float], ...] = (),
    **spots: list[tuple[Any, ...]],
) -> Macro:
    """Return a macro layout from the spots of each kind: (x, y, yaw, shift, turn), see `Spot`. Their order matters."""
    offers = (
        Offer(kind, _NAMES.get(kind, (kind,)), tuple(Spot(*row, *(_ANY_WAY if len(row) == 2 else ())) for row in rows))
        for kind, rows in spots.items()
    )
    return Macro(room, partitions, tuple(offers))


_ALL = (
    _macro(
        ((0.0, 0.0), (8.4, 0.0), (8.4, 6.0), (0.0, 6.0)),
        kitchen_counter=[(3.20, 5.495, -90.0)],
        fridge=[(1.22, 5.664, -90.0)],
        table_01=[(6.80, 3.80, 0.0, _FREE, 6.0), (6.60, 3.70, 90.0, _FREE, 6.0)],
        sofa=[(4.30, 2.05, 180.0, (0.15, 0.15), 4.0)],
        tvstand=[(0.235, 1.95, 0.0, _ALONG)],
        table_02=[(2.15, 2.00, 0.0, (0.10, 0.15), 6.0)],
        chair_01=[
            (2.20, 0.50, 90.0, (0.05, 0.20), 10.0),
            (7.65, 0.75, 135.0, _FREE, 15.0),
            (5.90, 0.55, 90.0, (0.05, 0.20), 15.0),
            (0.75, 3.55, -30.0, (0.10, 0.10), 15.0),
        ],
        bookcase=[(5.60, 5.835, -90.0, (0.0, 0.15)), (8.235, 2.00, 180.0, _ALONG)],
        plant=[(8.10, 5.70), (0.30, 0.30), (6.70, 5.70), (4.20, 0.30)],
        lamp=[(0.30, 3.20), (7.00, 0.30), (8.15, 5.10)],
        rug=[(2.45, 2.00, 0.0, (0.10, 0.10), 4.0)],
        picture=[(8.40, 3.60, 180.0, (0.0, 0.40)), (3.10, 0.0, 90.0, (0.0, 0.40))],
    ),
    _macro(
        ((0.0, 0.0), (9.0, 0.0), (9.0, 4.3), (5.2, 4.3), (5.2, 7.0), (0.0, 7.0)),
        kitchen_counter=[(0.505, 5.30, 0.0)],
        fridge=[(0.336, 3.32, 0.0)],
        table_01=[(3.55, 5.35, 0.0, _FREE, 6.0), (3.55, 5.20, 90.0, _FREE, 6.0)],
        sofa=[(6.40, 0.51, 90.0, (0.0, 0.20))],
        tvstand=[(6.55, 4.065, -90.0, _ALONG)],
        table_02=[(6.45, 2.15, 90.0, (0.10, 0.15), 6.0)],
        chair_01=[
            (8.40, 2.10, 180.0, (0.05, 0.15), 12.0),
            (2.80, 0.50, 90.0, (0.05, 0.25), 12.0),
            (4.10, 2.60, -20.0, (0.10, 0.10), 15.0),
            (0.55, 1.10, 20.0, (0.10, 0.15), 12.0),
        ],
        bookcase=[(5.035, 6.00, 180.0, (0.0, 0.15)), (1.70, 0.165, 90.0, (0.0, 0.20))],
        plant=[(8.70, 0.30), (8.70, 4.00), (4.90, 6.70), (0.30, 0.30)],
        lamp=[(4.95, 0.30), (8.20, 0.30), (4.90, 4.60)],
        rug=[(6.40, 2.10, 90.0, (0.10, 0.10), 4.0)],
        picture=[(3.40, 7.00, -90.0, (0.0, 0.40)), (0.0, 1.40, 0.0, (0.0, 0.40))],
    ),
    _macro(
        ((0.0, 0.0), (10.2, 0.0), (10.2, 5.0), (0.0, 5.0)),
        kitchen_counter=[(9.695, 1.70, 180.0)],
        fridge=[(9.864, 3.70, 180.0)],
        table_01=[(6.80, 2.40, 0.0, (0.10, 0.20), 6.0), (6.70, 2.50, 90.0, (0.10, 0.20), 6.0)],
        sofa=[(4.05, 2.55, 180.0, (0.15, 0.15), 4.0)],
        tvstand=[(0.235, 2.50, 0.0, _ALONG)],
        table_02=[(2.05, 2.50, 0.0, (0.10, 0.10), 6.0)],
        chair_01=[
            (2.10, 0.50, 90.0, (0.05, 0.20), 10.0),
            (2.10, 4.50, -90.0, (0.05, 0.20), 10.0),
            (5.60, 0.55, 90.0, (0.05, 0.20), 12.0),
            (6.10, 4.45, -90.0, (0.05, 0.25), 12.0),
        ],
        bookcase=[(4.40, 4.835, -90.0, (0.0, 0.25)), (4.30, 0.165, 90.0, (0.0, 0.25))],
        plant=[(0.30, 0.30), (0.30, 4.70), (7.40, 0.30), (7.90, 4.70)],
        lamp=[(0.30, 1.10), (0.30, 4.00), (3.20, 4.70)],
        rug=[(2.30, 2.50, 0.0, (0.10, 0.10), 4.0)],
        picture=[(6.70, 5.00, -90.0, (0.0, 0.50)), (6.80, 0.0, 90.0, (0.0, 0.50))],
    ),
    _macro(
        ((0.0, 0.0), (8.0, 0.0), (8.0, 7.4), (0.0, 7.4)),
        partitions=((0.0, 3.80, 4.70, 3.90),),
        kitchen_counter=[(3.10, 6.895, -90.0)],
        fridge=[(0.336, 5.10, 0.0)],
        table_01=[(6.55, 5.40, 0.0, _FREE, 6.0), (6.40, 5.50, 90.0, _FREE, 6.0)],
        sofa=[(2.40, 0.51, 90.0, (0.0, 0.20))],
        tvstand=[(2.35, 3.565, -90.0, _ALONG)],
        table_02=[(2.40, 2.05, 90.0, (0.05, 0.15), 6.0)],
        chair_01=[
            (0.50, 2.10, 0.0, (0.05, 0.15), 10.0),
            (5.00, 0.50, 90.0, (0.05, 0.20), 12.0),
            (7.40, 1.70, 180.0, (0.08, 0.20), 12.0),
            (7.35, 3.30, 180.0, (0.08, 0.15), 12.0),
        ],
        bookcase=[(5.60, 7.235, -90.0, (0.0, 0.20)), (6.30, 0.165, 90.0, (0.0, 0.20))],
        plant=[(7.70, 0.30), (0.30, 0.30), (7.70, 7.10), (4.05, 0.30)],
        lamp=[(0.30, 3.50), (7.70, 6.30), (3.85, 3.45)],
        rug=[(2.40, 2.00, 90.0, (0.10, 0.10), 4.0)],
        picture=[(8.00, 5.30, 180.0, (0.0, 0.50)), (2.40, 3.90, 90.0, (0.0, 0.40))],
    ),
    _macro(
        ((0.0, 0.0), (6.4, 0.0), (6.4, 2.6), (9.4, 2.6), (9.4, 7.2), (3.2, 7.2), (3.2, 5.0), (0.0, 5.0)),
        kitchen_counter=[(1.80, 0.505, 90.0)],
        fridge=[(3.80, 0.336, 90.0)],
        table_01=[(4.30, 4.00, 0.0, _FREE, 6.0), (4.10, 3.90, 90.0, _FREE, 6.0)],
        sofa=[(8.89, 5.00, 180.0, (0.0, 0.15))],
        tvstand=[(7.00, 6.965, -90.0, _ALONG)],
        table_02=[(7.20, 5.00, 0.0, (0.10, 0.10), 6.0)],
        chair_01=[
            (7.20, 3.10, 90.0, (0.05, 0.20), 10.0),
            (0.50, 3.30, 0.0, (0.05, 0.20), 12.0),
            (4.00, 6.55, -60.0, (0.10, 0.10), 12.0),
            (0.75, 4.45, -50.0, (0.08, 0.08), 12.0),
        ],
        bookcase=[(1.90, 4.835, -90.0, (0.0, 0.15)), (5.60, 7.035, -90.0, (0.0, 0.15))],
        plant=[(9.10, 2.90), (9.10, 6.90), (6.10, 0.30), (3.50, 5.35)],
        lamp=[(5.95, 2.30), (8.30, 2.85), (8.30, 6.95)],
        rug=[(7.50, 4.90, 0.0, (0.10, 0.10), 4.0)],
        picture=[(0.0, 2.30, 0.0, (0.0, 0.30)), (6.40, 1.30, 180.0, (0.0, 0.20))],
    ),
)


def macro_layout(macro: int) -> Macro:
    """Return the macro layout of a number, 0 to 4; another number raises HomeError."""
    if not 0 <= macro < MACROS:
        raise HomeError(f"macro layout must be one of 0 to {MACROS - 1}, not {macro}")
    return _ALL[macro]
