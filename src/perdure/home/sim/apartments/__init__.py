"""Apartments: five macro layouts with 21 micro variations each, where a robot fits in them, and their MuJoCo models.

Contents:
    make_apartment, split_apartments, SPLITS    which apartments there are, and for what
    Apartment, Piece, Receptacle, Articulation  what they are made of, as records
    free_space, FreeSpace, Geodesic             where a round robot can be and how far that is
    static_footprints, moving_footprints        what stands in its way
    build_apartment                             from the record to a MuJoCo specification
    cut_away                                    walls hidden for a camera outside
"""

from perdure.home.sim.apartments.apartment import MICROS, SPLITS, make_apartment, split_apartments
from perdure.home.sim.apartments.build import build_apartment, cut_away
from perdure.home.sim.apartments.footprint import moving_footprints, static_footprints
from perdure.home.sim.apartments.free_space import (
    CELL,
    OVERESTIMATE,
    RADIUS,
    FreeSpace,
    Geodesic,
    free_space,
    in_sight,
    path_length,
)
from perdure.home.sim.apartments.fridge import OPEN as FRIDGE_OPEN
from perdure.home.sim.apartments.macros import MACROS
from perdure.home.sim.apartments.piece import Apartment, Articulation, Piece, Pose, Receptacle, Solid, Zone

__all__ = [
    "CELL",
    "FRIDGE_OPEN",
    "MACROS",
    "MICROS",
    "OVERESTIMATE",
    "RADIUS",
    "SPLITS",
    "Apartment",
    "Articulation",
    "FreeSpace",
    "Geodesic",
    "Piece",
    "Pose",
    "Receptacle",
    "Solid",
    "Zone",
    "build_apartment",
    "cut_away",
    "free_space",
    "in_sight",
    "make_apartment",
    "moving_footprints",
    "path_length",
    "split_apartments",
    "static_footprints",
]
