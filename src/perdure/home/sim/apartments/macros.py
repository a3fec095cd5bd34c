"""The five macro layouts: the rooms, and where their furniture stands before a micro variation moves it (all OURS).

A `Spot` is one place a piece may take, with how far a micro variation may move it along its own x and y and turn it. A
group of spots for one kind is an offer: the micro variation takes as many of them as there are names.
"""

from __future__ import annotations

from dataclasses import dataclass

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


_WALL_SHIFT = (0.0, 0.20)  # along the wall only
_TABLE = (0.15, 0.15)
_FREE = (0.15, 0.15)


def _one(kind: str, *spots: Spot) -> Offer:
    return Offer(kind, (kind,), spots)


def _chairs(*spots: Spot) -> Offer:
    return Offer("chair_01", ("chair_01_0", "chair_01_1"), spots)


def _plants(*spots: tuple[float, float]) -> Offer:
    return Offer("plant", ("plant_0", "plant_1"), tuple(Spot(x, y, 0.0, (0.04, 0.04), 180.0) for x, y in spots))


def _lamps(*spots: tuple[float, float]) -> Offer:
    return Offer("lamp", ("lamp",), tuple(Spot(x, y, 0.0, (0.04, 0.04), 180.0) for x, y in spots))


_MACRO_0 = Macro(
    room=((0.0, 0.0), (8.4, 0.0), (8.4, 6.0), (0.0, 6.0)),
    partitions=(),
    offers=(
        _one("kitchen_counter", Spot(3.20, 5.495, -90.0)),
        _one("fridge", Spot(1.22, 5.664, -90.0)),
        _one("table_01", Spot(6.80, 3.80, 0.0, _TABLE, 6.0), Spot(6.60, 3.70, 90.0, _TABLE, 6.0)),
        _one("sofa", Spot(4.30, 2.05, 180.0, (0.15, 0.15), 4.0)),
        _one("tvstand", Spot(0.235, 1.95, 0.0, _WALL_SHIFT)),
        _one("table_02", Spot(2.15, 2.00, 0.0, (0.10, 0.15), 6.0)),
        _chairs(
            Spot(2.20, 0.50, 90.0, (0.05, 0.20), 10.0),
            Spot(7.65, 0.75, 135.0, _FREE, 15.0),
            Spot(5.90, 0.55, 90.0, (0.05, 0.20), 15.0),
            Spot(0.75, 3.55, -30.0, (0.10, 0.10), 15.0),
        ),
        _one("bookcase", Spot(5.60, 5.835, -90.0, (0.0, 0.15)), Spot(8.235, 2.00, 180.0, _WALL_SHIFT)),
        _plants((8.10, 5.70), (0.30, 0.30), (6.70, 5.70), (4.20, 0.30)),
        _lamps((0.30, 3.20), (7.00, 0.30), (8.15, 5.10)),
        _one("rug", Spot(2.45, 2.00, 0.0, (0.10, 0.10), 4.0)),
        _one("picture", Spot(8.40, 3.60, 180.0, (0.0, 0.40)), Spot(3.10, 0.0, 90.0, (0.0, 0.40))),
    ),
)

_MACRO_1 = Macro(
    room=((0.0, 0.0), (9.0, 0.0), (9.0, 4.3), (5.2, 4.3), (5.2, 7.0), (0.0, 7.0)),
    partitions=(),
    offers=(
        _one("kitchen_counter", Spot(0.505, 5.30, 0.0)),
        _one("fridge", Spot(0.336, 3.32, 0.0)),
        _one("table_01", Spot(3.55, 5.35, 0.0, _TABLE, 6.0), Spot(3.55, 5.20, 90.0, _TABLE, 6.0)),
        _one("sofa", Spot(6.40, 0.51, 90.0, (0.0, 0.20))),
        _one("tvstand", Spot(6.55, 4.065, -90.0, _WALL_SHIFT)),
        _one("table_02", Spot(6.45, 2.15, 90.0, (0.10, 0.15), 6.0)),
        _chairs(
            Spot(8.40, 2.10, 180.0, (0.05, 0.15), 12.0),
            Spot(2.80, 0.50, 90.0, (0.05, 0.25), 12.0),
            Spot(4.10, 2.60, -20.0, (0.10, 0.10), 15.0),
            Spot(0.55, 1.10, 20.0, (0.10, 0.15), 12.0),
        ),
        _one("bookcase", Spot(5.035, 6.00, 180.0, (0.0, 0.15)), Spot(1.70, 0.165, 90.0, (0.0, 0.20))),
        _plants((8.70, 0.30), (8.70, 4.00), (4.90, 6.70), (0.30, 0.30)),
        _lamps((4.95, 0.30), (8.20, 0.30), (4.90, 4.60)),
        _one("rug", Spot(6.40, 2.10, 90.0, (0.10, 0.10), 4.0)),
        _one("picture", Spot(3.40, 7.00, -90.0, (0.0, 0.40)), Spot(0.0, 1.40, 0.0, (0.0, 0.40))),
    ),
)

_MACRO_2 = Macro(
    room=((0.0, 0.0), (10.2, 0.0), (10.2, 5.0), (0.0, 5.0)),
    partitions=(),
    offers=(
        _one("kitchen_counter", Spot(9.695, 1.70, 180.0)),
        _one("fridge", Spot(9.864, 3.70, 180.0)),
        _one("table_01", Spot(6.80, 2.40, 0.0, (0.10, 0.20), 6.0), Spot(6.70, 2.50, 90.0, (0.10, 0.20), 6.0)),
        _one("sofa", Spot(4.05, 2.55, 180.0, (0.15, 0.15), 4.0)),
        _one("tvstand", Spot(0.235, 2.50, 0.0, _WALL_SHIFT)),
        _one("table_02", Spot(2.05, 2.50, 0.0, (0.10, 0.10), 6.0)),
        _chairs(
            Spot(2.10, 0.50, 90.0, (0.05, 0.20), 10.0),
            Spot(2.10, 4.50, -90.0, (0.05, 0.20), 10.0),
            Spot(5.60, 0.55, 90.0, (0.05, 0.20), 12.0),
            Spot(6.10, 4.45, -90.0, (0.05, 0.25), 12.0),
        ),
        _one("bookcase", Spot(4.40, 4.835, -90.0, (0.0, 0.25)), Spot(4.30, 0.165, 90.0, (0.0, 0.25))),
        _plants((0.30, 0.30), (0.30, 4.70), (7.40, 0.30), (7.90, 4.70)),
        _lamps((0.30, 1.10), (0.30, 4.00), (3.20, 4.70)),
        _one("rug", Spot(2.30, 2.50, 0.0, (0.10, 0.10), 4.0)),
        _one("picture", Spot(6.70, 5.00, -90.0, (0.0, 0.50)), Spot(6.80, 0.0, 90.0, (0.0, 0.50))),
    ),
)

_MACRO_3 = Macro(
    room=((0.0, 0.0), (8.0, 0.0), (8.0, 7.4), (0.0, 7.4)),
    partitions=((0.0, 3.80, 4.70, 3.90),),
    offers=(
        _one("kitchen_counter", Spot(3.10, 6.895, -90.0)),
        _one("fridge", Spot(0.336, 5.10, 0.0)),
        _one("table_01", Spot(6.55, 5.40, 0.0, _TABLE, 6.0), Spot(6.40, 5.50, 90.0, _TABLE, 6.0)),
        _one("sofa", Spot(2.40, 0.51, 90.0, (0.0, 0.20))),
        _one("tvstand", Spot(2.35, 3.565, -90.0, _WALL_SHIFT)),
        _one("table_02", Spot(2.40, 2.05, 90.0, (0.05, 0.15), 6.0)),
        _chairs(
            Spot(0.50, 2.10, 0.0, (0.05, 0.15), 10.0),
            Spot(5.00, 0.50, 90.0, (0.05, 0.20), 12.0),
            Spot(7.40, 1.70, 180.0, (0.08, 0.20), 12.0),
            Spot(7.35, 3.30, 180.0, (0.08, 0.15), 12.0),
        ),
        _one("bookcase", Spot(5.60, 7.235, -90.0, (0.0, 0.20)), Spot(6.30, 0.165, 90.0, (0.0, 0.20))),
        _plants((7.70, 0.30), (0.30, 0.30), (7.70, 7.10), (4.05, 0.30)),
        _lamps((0.30, 3.50), (7.70, 6.30), (3.85, 3.45)),
        _one("rug", Spot(2.40, 2.00, 90.0, (0.10, 0.10), 4.0)),
        _one("picture", Spot(8.00, 5.30, 180.0, (0.0, 0.50)), Spot(2.40, 3.90, 90.0, (0.0, 0.40))),
    ),
)

_MACRO_4 = Macro(
    room=((0.0, 0.0), (6.4, 0.0), (6.4, 2.6), (9.4, 2.6), (9.4, 7.2), (3.2, 7.2), (3.2, 5.0), (0.0, 5.0)),
    partitions=(),
    offers=(
        _one("kitchen_counter", Spot(1.80, 0.505, 90.0)),
        _one("fridge", Spot(3.80, 0.336, 90.0)),
        _one("table_01", Spot(4.30, 4.00, 0.0, _TABLE, 6.0), Spot(4.10, 3.90, 90.0, _TABLE, 6.0)),
        _one("sofa", Spot(8.89, 5.00, 180.0, (0.0, 0.15))),
        _one("tvstand", Spot(7.00, 6.965, -90.0, _WALL_SHIFT)),
        _one("table_02", Spot(7.20, 5.00, 0.0, (0.10, 0.10), 6.0)),
        _chairs(
            Spot(7.20, 3.10, 90.0, (0.05, 0.20), 10.0),
            Spot(0.50, 3.30, 0.0, (0.05, 0.20), 12.0),
            Spot(4.00, 6.55, -60.0, (0.10, 0.10), 12.0),
            Spot(0.75, 4.45, -50.0, (0.08, 0.08), 12.0),
        ),
        _one("bookcase", Spot(1.90, 4.835, -90.0, (0.0, 0.15)), Spot(5.60, 7.035, -90.0, (0.0, 0.15))),
        _plants((9.10, 2.90), (9.10, 6.90), (6.10, 0.30), (3.50, 5.35)),
        _lamps((5.95, 2.30), (8.30, 2.85), (8.30, 6.95)),
        _one("rug", Spot(7.50, 4.90, 0.0, (0.10, 0.10), 4.0)),
        _one("picture", Spot(0.0, 2.30, 0.0, (0.0, 0.30)), Spot(6.40, 1.30, 180.0, (0.0, 0.20))),
    ),
)

_ALL = (_MACRO_0, _MACRO_1, _MACRO_2, _MACRO_3, _MACRO_4)


def macro_layout(macro: int) -> Macro:
    """The macro layout of that number, 0 to 4; another number raises HomeError."""
    if not 0 <= macro < MACROS:
        raise HomeError(f"macro layout must be one of 0 to {MACROS - 1}, not {macro}")
    return _ALL[macro]
