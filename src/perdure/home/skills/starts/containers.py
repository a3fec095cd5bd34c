"""Drawers and the fridge: which one contains an object, how far it is open, what moves with it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from perdure.home.benchmark.episodes import Episode
from perdure.home.errors import HomeError
from perdure.home.sim.apartments import Apartment, Pose
from perdure.home.sim.objects import Placement
from perdure.home.sim.world import Simulator

DRAWER_OPEN, FRIDGE_OPEN = (0.4, 0.5), (1.5, 2.35)
"""Uniform ranges in [m] and [rad] for pick from and place into a container (M3)."""


def needed_container(episode: Episode, target: int) -> str:
    """Return the drawer or door that a target begins in; HomeError when it begins in the open."""
    link = episode.container(target)
    if link is None:
        raise HomeError(f"target {target} of {episode.name} is not in a drawer or fridge: nothing to open or close")
    return link


def front_of(apartment: Apartment, placement: Placement) -> tuple[float, float]:
    """Return the direction in which a placement's furniture faces, a unit vector in the room."""
    yaw = apartment.piece(apartment.receptacle(placement.receptacle).piece).pose.yaw
    return math.cos(yaw), math.sin(yaw)


def draw_open(apartment: Apartment, link: str | None, rng: np.random.Generator) -> dict[str, float]:
    """Draw how far a container is open for pick or place; empty for None."""
    if link is None:
        return {}
    low, high = DRAWER_OPEN if is_drawer(apartment, link) else FRIDGE_OPEN
    return {link: float(rng.uniform(low, high))}


def open_links(simulator: Simulator) -> dict[str, float]:
    """Return the positions of open drawers and doors in [m] or [rad] by link name.

    Values are rounded to 0.01, so that cached free spaces are found again. Values up to 0.02 count as closed.
    """
    q = simulator.qpos[simulator.scene.link_qpos]
    rounded = {link: round(float(value), 2) for link, value in zip(simulator.scene.links, q, strict=True)}
    return {link: value for link, value in rounded.items() if abs(value) > 0.02}


def is_drawer(apartment: Apartment, link: str) -> bool:
    """Return whether a link slides."""
    return apartment.articulation(link).kind == "slide"


def carried(episode: Episode, target: int, opened: Mapping[str, float]) -> dict[int, Placement]:
    """Return where a target lies that has moved with its drawer, as `Start.moved`; empty when it has not moved."""
    placement = episode.objects[target]
    link = episode.apartment().receptacle(placement.receptacle).link
    if link is None or link not in opened:
        return {}
    moving, pose = episode.apartment().articulation(link), episode.apartment().piece_of(link).pose
    way = (opened[link] - episode.opened.get(link, 0.0)) * np.asarray(moving.axis)
    x, y, z = pose.to_room(pose.to_local(np.asarray(placement.position)) + way)
    return {0: replace(placement, position=(float(x), float(y), float(z)))}


def handle(apartment: Apartment, link: str, q: float) -> tuple[float, float, float]:
    """Return the position of a handle in the room in [m] when its link is at `q`."""
    x, y, z = apartment.handle_to_room(link, q)
    return float(x), float(y), float(z)


def front_frame(apartment: Apartment, link: str, q: float) -> Pose:
    """Return the frame of rectangles in front of a container: at a drawer's handle, at the fridge's center."""
    piece = apartment.piece_of(link).pose
    if not is_drawer(apartment, link):
        return piece
    x, y, _ = handle(apartment, link, q)
    return Pose(x, y, piece.yaw)


def link_number(apartment: Apartment, link: str) -> int:
    """Return a link's number in `Scene.links`."""
    return [moving.link for moving in apartment.articulations].index(link)
