"""The robot's start pose: drawn by the evaluation seed, not stored in the episode."""

from __future__ import annotations

import hashlib
import math

import numpy as np

from perdure.home.benchmark.episodes.episode import Episode
from perdure.home.errors import HomeError
from perdure.home.sim.apartments import Apartment, Pose, free_space, plane
from perdure.home.sim.apartments.footprint import apartment_footprints
from perdure.home.sim.apartments.free_space import CELL

ARM_LOW = 0.6
"""Furniture that ends below this height in [m] does not meet the arm at rest."""
ARM_FROM, ARM_TO, ARM_RADIUS = 0.10, 0.45, 0.20
"""The arm at rest, seen from above: discs along the robot's x from 0.10 to 0.45 m (the gripper rests at 0.5 m)."""


def start_pose(apartment: Apartment, episode: Episode, seed: int) -> Pose:
    """Return the robot's start pose: uniform over the largest island and headings, the resting arm free of furniture.

    `apartment` is the episode's; the same evaluation seed gives the same pose. HomeError for a negative seed or another
    episode's apartment.
    """
    if seed < 0:
        raise HomeError(f"an evaluation seed is 0 or more, not {seed}")
    if apartment.fingerprint != episode.apartment_fingerprint:
        raise HomeError(f"{episode.name} does not play in {apartment.name} {apartment.fingerprint}")
    space = free_space(apartment, episode.opened)
    tall = apartment_footprints(apartment, episode.opened, low=ARM_LOW)
    digest = hashlib.sha256(episode.name.encode()).digest()
    rng = np.random.Generator(np.random.PCG64([seed, *digest[:8]]))
    low, high = np.min(apartment.room, axis=0), np.max(apartment.room, axis=0)
    while True:
        across, along, turn = rng.random(3)
        point = low + (across, along) * (high - low)
        pose = Pose(float(point[0]), float(point[1]), 2.0 * math.pi * float(turn))
        if not space.is_free(point[None])[0]:
            continue
        discs = pose.to_room(np.stack([np.linspace(ARM_FROM, ARM_TO, 8), np.zeros(8)], axis=-1))
        if plane.clearance(discs, tall).min() < ARM_RADIUS or not plane.inside(discs, apartment.room).all():
            continue
        if space.nearest(point[None])[1][0] <= CELL:
            return pose
