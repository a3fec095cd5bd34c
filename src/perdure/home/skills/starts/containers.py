"""How far drawers and the fridge are open when a skill begins, and what moves along with them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from perdure.home.benchmark.episodes import Episode
from perdure.home.sim.apartments import Apartment, Pose
from perdure.home.sim.objects import Placement

FRIDGE_DOOR = "top_door"
DRAWER_OPEN, FRIDGE_OPEN = (0.4, 0.5), (1.5, 2.35)
"""Uniform ranges in [m] and [rad] when an object inside is picked or a goal inside is placed at (M3)."""


def goal_container(episode: Episode, target: int) -> str | None:
    """The drawer or door one must open to get at a target's goal: a link name, None when it is in the open."""
    apartment = episode.apartment()
    receptacle = apartment.receptacle(episode.goals[target].receptacle)
    return FRIDGE_DOOR if apartment.piece(receptacle.piece).kind == "fridge" else receptacle.link


def draw_open(apartment: Apartment, link: str | None, rng: np.random.Generator) -> dict[str, float]:
    """A container opened as it would be before pick or place; nothing for None."""
    if link is None:
        return {}
    low, high = DRAWER_OPEN if is_drawer(apartment, link) else FRIDGE_OPEN
    return {link: float(rng.uniform(low, high))}


def is_drawer(apartment: Apartment, link: str) -> bool:
    """Whether a link slides."""
    return apartment.articulation(link).kind == "slide"


def carried(episode: Episode, target: int, opened: Mapping[str, float]) -> dict[int, Placement]:
    """The target in its drawer, moved along with it; nothing when it does not lie in one that moved."""
    placement = episode.objects[target]
    link = episode.apartment().receptacle(placement.receptacle).link
    if link is None or link not in opened:
        return {}
    moving, pose = episode.apartment().articulation(link), episode.apartment().piece_of(link).pose
    way = (opened[link] - episode.opened.get(link, 0.0)) * np.asarray(moving.axis)
    x, y, z = pose.to_room(pose.to_local(np.asarray(placement.position)) + way)
    return {0: replace(placement, position=(float(x), float(y), float(z)))}


def handle(apartment: Apartment, link: str, q: float) -> tuple[float, float, float]:
    """Where a handle is, in the room."""
    x, y, z = apartment.handle_to_room(link, q)
    return float(x), float(y), float(z)


def handle_frame(apartment: Apartment, link: str, q: float) -> Pose:
    """The frame of a drawer's handle: x away from the piece."""
    x, y, _ = handle(apartment, link, q)
    return Pose(x, y, apartment.piece_of(link).pose.yaw)


def link_number(apartment: Apartment, link: str) -> int:
    """Its number in `Scene.links`."""
    return [moving.link for moving in apartment.articulations].index(link)
