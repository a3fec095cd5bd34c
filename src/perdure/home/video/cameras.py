"""Cameras: the whole apartment from above or as a doll's house, the robot's own cameras, a following camera."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from perdure.home.errors import HomeError
from perdure.home.sim.apartments import Apartment
from perdure.home.sim.arrays import FloatArray

CameraName = Literal["doll_house", "plan", "head", "hand", "follow"]
CAMERAS: tuple[str, ...] = get_args(CameraName)
OWN = ("head", "hand")
"""Cameras that the robot carries."""

FOVY = 36.0
"""Vertical field of view in [deg]: narrower than MuJoCo's 45, so that furniture leans less."""
DOLL_HOUSE_ELEVATION = 52.0
"""How far the doll's house is looked down at in [deg]."""
LOW_WALL = 1.0
"""Height in [m] up to which a picture of the whole apartment shows its walls in any case."""


@dataclass(frozen=True, eq=False)
class Shot:
    """A camera in the room that looks from `eye` at `target`, the horizon level."""

    eye: FloatArray
    """Shape (3,), in [m]."""
    target: FloatArray
    """Shape (3,), in [m]."""
    up: tuple[float, float, float] = (0.0, 0.0, 1.0)
    """Upward direction in the picture; north for a camera that looks straight down."""

    @property
    def axes(self) -> FloatArray:
        """Rows: right, up and forward of the picture in the room. Shape (3, 3)."""
        forward = (self.target - self.eye) / np.linalg.norm(self.target - self.eye)
        right = np.cross(forward, self.up)
        right /= np.linalg.norm(right)
        return np.stack([right, np.cross(right, forward), forward])

    def angles(self) -> tuple[float, float, float]:
        """Return azimuth and elevation in [deg] and distance in [m] of MuJoCo's free camera."""
        forward = self.axes[2]
        level = self.axes[1] if abs(forward[2]) > 0.9999 else forward
        azimuth = float(np.degrees(np.arctan2(level[1], level[0])))
        elevation = float(np.degrees(np.arcsin(np.clip(forward[2], -1.0, 1.0))))
        return azimuth, elevation, float(np.linalg.norm(self.target - self.eye))

    def project(self, points: FloatArray, size: tuple[int, int]) -> FloatArray:
        """Return where points of the room (n, 3) in [m] are in a picture of (width, height) pixels. Shape (n, 3).

        Pixels to the right and down from the upper left corner, and the depth in [m] (negative behind the camera).
        """
        right, up, depth = self.axes @ (points - self.eye).T
        scale = 0.5 * size[1] / np.tan(np.radians(0.5 * FOVY)) / np.where(np.abs(depth) < 1e-6, 1e-6, depth)
        return np.stack([0.5 * size[0] + scale * right, 0.5 * size[1] - scale * up, depth], axis=1)


def whole_apartment(apartment: Apartment, camera: str, size: tuple[int, int]) -> Shot:
    """Return the camera `doll_house` or `plan`, as near as the whole apartment fits into the picture."""
    corners = np.array(apartment.room)
    middle = np.array([*(0.5 * (corners.min(axis=0) + corners.max(axis=0))), 0.0])
    points = np.concatenate([np.c_[corners, np.full(len(corners), z)] for z in (0.0, LOW_WALL)])
    if camera == "plan":
        return _fit(points, middle, np.array([0.0, 0.0, 1.0]), size, (0.0, 1.0, 0.0))
    yaw = next((p.pose.yaw for p in apartment.pieces if p.kind == "kitchen_counter"), 0.5 * np.pi)
    down = np.radians(DOLL_HOUSE_ELEVATION)
    backward = np.array([np.cos(down) * np.cos(yaw), np.cos(down) * np.sin(yaw), np.sin(down)])
    return _fit(points, middle, backward, size, (0.0, 0.0, 1.0))


def check_camera(name: str) -> str:
    """Return the name of a camera; HomeError when there is none of that name."""
    if name not in CAMERAS:
        raise HomeError(f"no camera is named {name!r}; there are {', '.join(CAMERAS)}")
    return name


def _fit(
    points: FloatArray, middle: FloatArray, backward: FloatArray, size: tuple[int, int], up: tuple[float, float, float]
) -> Shot:
    """Move a camera back until all points are in the picture, then centers them."""
    target, distance = middle, 30.0
    for _ in range(8):
        shot = Shot(target + distance * backward, target, up)
        pixels = shot.project(points, size)[:, :2]
        low, high = pixels.min(axis=0), pixels.max(axis=0)
        off = (0.5 * (low + high) - 0.5 * np.array(size)) * 2.0 * np.tan(np.radians(0.5 * FOVY)) * distance / size[1]
        target = target + off[0] * shot.axes[0] - off[1] * shot.axes[1]
        distance *= float(np.max((high - low) / np.array(size))) / 0.95
    return Shot(target + distance * backward, target, up)
