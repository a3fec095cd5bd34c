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
from perdure.home.sim.apartments.free_space import FreeSpace, Geodesic, free_space, in_sight
from perdure.home.sim.apartments.fridge import OPEN as FRIDGE_OPEN
from perdure.home.sim.apartments.macros import MACROS
from perdure.home.sim.apartments.piece import FRIDGE_DOOR, Apartment, Articulation, Piece, Pose, Receptacle

__all__ = [
    "FRIDGE_DOOR",
    "FRIDGE_OPEN",
    "MACROS",
    "MICROS",
    "SPLITS",
    "Apartment",
    "Articulation",
    "FreeSpace",
    "Geodesic",
    "Piece",
    "Pose",
    "Receptacle",
    "build_apartment",
    "cut_away",
    "free_space",
    "in_sight",
    "make_apartment",
    "moving_footprints",
    "split_apartments",
    "static_footprints",
]
