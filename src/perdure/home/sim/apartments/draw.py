"""A top-down drawing of an apartment: floor plan, furniture, receptacles, free space."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from perdure.home.sim.apartments import plane
from perdure.home.sim.apartments.colors import PALETTE
from perdure.home.sim.apartments.footprint import footprints
from perdure.home.sim.apartments.free_space import FreeSpace, free_space
from perdure.home.sim.apartments.records import Apartment, Piece

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_INK = "#3a3a3a"


def draw_apartment(apartment: Apartment, axes: Axes, opened: Mapping[str, float] | None = None) -> None:
    """Draws an apartment into matplotlib axes.

    Args:
        apartment: What to draw.
        axes: Where to draw it.
        opened: Joint positions of drawers and doors by link name, 0 where not given.
    """
    _draw_floor(apartment, free_space(apartment, opened), axes)
    for piece in sorted(apartment.pieces, key=lambda p: p.kind != "rug"):
        _draw_piece(piece, opened, axes)
    for wall in apartment.walls:
        _fill(axes, plane.corners(footprints(wall))[0], facecolor="#5b5955", edgecolor="none", zorder=4)
    for receptacle in apartment.receptacles:
        outline = np.array([(1, 1), (-1, 1), (-1, -1), (1, -1)]) * receptacle.half
        ring = apartment.surface_to_room(receptacle, outline, opened)[:, :2]
        _fill(axes, ring, fill=False, edgecolor="#b5482f", linestyle=":", linewidth=1.0, zorder=6)
    for moving in apartment.articulations:
        handle = apartment.handle_to_room(moving.link, (opened or {}).get(moving.link, 0.0))
        axes.plot(handle[0], handle[1], ".", color="#b5482f", markersize=4, zorder=7)
    axes.set_aspect("equal")
    axes.set_axis_off()
    axes.set_title(apartment.name, fontsize=9, color=_INK)


def save_plan(apartment: Apartment, path: str | Path, opened: Mapping[str, float] | None = None) -> None:
    """Writes the drawing of one apartment as a picture file (PNG, SVG or PDF by its ending)."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.4, 5.0), layout="constrained")
    draw_apartment(apartment, figure.add_subplot(), opened)
    figure.savefig(path, dpi=150)


def cut_away(model: Any, apartment: Apartment, eye: NDArray[np.float64]) -> None:
    """Makes the walls (and the pictures on them) between a camera and the room invisible, as in a doll's house.

    Args:
        model: A compiled MuJoCo model of the apartment; colours are changed in place.
        apartment: The apartment it was built from.
        eye: Position of the camera in the room. Shape (3,).
    """
    for piece in (*apartment.walls, *apartment.pieces):
        if piece.kind not in ("wall", "picture") or piece.name.startswith("partition"):
            continue
        facing = piece.pose.yaw + (np.pi / 2.0 if piece.kind == "wall" else 0.0)  # where its room side looks
        if (eye[0] - piece.pose.x) * np.cos(facing) + (eye[1] - piece.pose.y) * np.sin(facing) < 0.0:
            for solid in piece.solids:
                model.geom(f"{piece.name}/{solid.name}").rgba[3] = 0.0


def _draw_floor(apartment: Apartment, space: FreeSpace, axes: Axes) -> None:
    _fill(axes, np.array(apartment.room), facecolor="#efe9df", edgecolor="none", zorder=0)
    low = np.min(apartment.room, axis=0)
    rows, columns = space.free.shape
    picture = np.zeros((rows, columns, 4))
    picture[space.free] = (0.46, 0.60, 0.55, 0.28)
    extent = (low[0], low[0] + columns * space.cell, low[1], low[1] + rows * space.cell)
    axes.imshow(picture, origin="lower", extent=extent, zorder=1, interpolation="nearest")


def _draw_piece(piece: Piece, opened: Mapping[str, float] | None, axes: Axes) -> None:
    color = PALETTE[piece.solids[0].color]
    if piece.kind == "rug":
        solid = piece.solids[0]
        ring = plane.corners(np.array([[piece.pose.x, piece.pose.y, *solid.half[:2], piece.pose.yaw]]))[0]
        _fill(axes, ring, facecolor=(*color[:3], 0.5), edgecolor="none", zorder=0.5)
        return
    shapes = footprints(piece, opened, low=-1.0, high=10.0)
    for ring in plane.corners(shapes):
        _fill(axes, ring, facecolor=color, edgecolor=_INK, linewidth=0.6, zorder=3)
    if piece.receptacles or piece.kind == "bookcase":
        axes.text(piece.pose.x, piece.pose.y, piece.name, fontsize=5.5, ha="center", va="center", color=_INK, zorder=8)


def _fill(axes: Axes, ring: NDArray[np.float64], **style: Any) -> None:
    from matplotlib.patches import Polygon

    axes.add_patch(Polygon(ring, closed=True, **style))
