"""Where the handles of an apartment are, as numbers ready to be used at every step."""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import lru_cache

import numpy as np

from perdure.home.sim.apartments import Apartment
from perdure.home.sim.arrays import FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class Handles:
    """Handles of all drawers and doors in the room.

    A drawer's handle at joint position q is at origin + q * slide; a door's turns about its vertical hinge.
    """

    origin: FloatArray
    """At q = 0 for drawers, the hinge at the handle's height for doors. Shape (..., links, 3)."""
    slide: FloatArray
    """Direction of a drawer in the room, 0 for doors. Shape (..., links, 3)."""
    lever: FloatArray
    """From a door's hinge to its handle at q = 0 in the room's x and y, 0 for drawers. Shape (..., links, 2)."""
    sign: FloatArray
    """Whether a door turns to the left (1) or to the right (-1) as q grows, 0 for drawers. Shape (..., links)."""

    @staticmethod
    @lru_cache(maxsize=256)
    def of(apartment: Apartment) -> Handles:
        """Return the handles of an apartment, in the order of its articulations."""
        rows = []
        for moving in apartment.articulations:
            pose = apartment.piece_of(moving.link).pose
            handle = apartment.handle_to_room(moving.link, 0.0)
            axis = pose.to_room(np.asarray(moving.axis)) - pose.to_room(np.zeros(3))
            if moving.kind == "slide":
                rows.append((handle, axis, np.zeros(2), 0.0))
            else:
                hinge = pose.to_room(np.asarray(moving.origin))
                at = np.array([hinge[0], hinge[1], handle[2]])
                rows.append((at, np.zeros(3), handle[:2] - hinge[:2], moving.axis[2]))
        origin, slide, lever, sign = (np.array([row[k] for row in rows], dtype=np.float64) for k in range(4))
        return Handles(origin.reshape(-1, 3), slide.reshape(-1, 3), lever.reshape(-1, 2), sign)

    @staticmethod
    def none(lanes: int, links: int) -> Handles:
        """Return room for the handles of many lanes, all infinitely far."""
        shape = lanes, links
        return Handles(np.full((*shape, 3), np.inf), np.zeros((*shape, 3)), np.zeros((*shape, 2)), np.zeros(shape))

    def __getitem__(self, lanes: IntArray) -> Handles:
        """Those of some lanes."""
        return Handles(self.origin[lanes], self.slide[lanes], self.lever[lanes], self.sign[lanes])

    def put(self, lane: int, other: Handles) -> None:
        """Give a lane the handles of its apartment; room it does not need stays infinitely far."""
        count = len(other.sign)
        for name, empty in (("origin", np.inf), ("slide", 0.0), ("lever", 0.0), ("sign", 0.0)):
            values = getattr(self, name)[lane]
            values[:count], values[count:] = getattr(other, name), empty

    def widened(self, more: int) -> Handles:
        """Return a copy with space for more handles in each lane."""
        empty = Handles.none(len(self.sign), more)
        return Handles(
            *(np.concatenate([getattr(self, each.name), getattr(empty, each.name)], axis=1) for each in fields(self))
        )

    def at(self, q: FloatArray) -> FloatArray:
        """Return all handles. Shape (..., links) -> (..., links, 3)."""
        cos, sin = np.cos(self.sign * q), np.sin(self.sign * q)
        points: FloatArray = self.origin + q[..., None] * self.slide
        points[..., 0] += cos * self.lever[..., 0] - sin * self.lever[..., 1]
        points[..., 1] += sin * self.lever[..., 0] + cos * self.lever[..., 1]
        return points

    def one(self, link: int, q: float) -> FloatArray:
        """Return one handle, the same bits as in `at`. Shape (3,)."""
        part = slice(link, link + 1)
        angle = self.sign[part] * q
        cos, sin = np.cos(angle)[0], np.sin(angle)[0]
        point: FloatArray = self.origin[link] + q * self.slide[link]
        lever = self.lever[link]
        point[0] += cos * lever[0] - sin * lever[1]
        point[1] += sin * lever[0] + cos * lever[1]
        return point
