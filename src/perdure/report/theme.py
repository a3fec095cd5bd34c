"""Style of all figures: colors, dash patterns, shapes, fonts, sizes.

Colors follow Okabe and Ito, "Color Universal Design" (2008); the scale for ordered values follows viridis (Smith and
van der Walt, 2015), cut where it would vanish into the background. A color never stands alone: a dash pattern, a shape
or a name at the curve says the same again, for readers who see no color and for print.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

WIDTH, WIDE, HEIGHT = 660, 1120, 290
"""Width of half-page and of full-page figures, and height, each of the area between the axes. [px]"""
PNG_SCALE = 2.0
"""Pixels of a PNG for each of these."""
FONT, FONT_SIZE, TITLE_SIZE = "Helvetica, Arial, sans-serif", 11, 14
LETTER = 0.52
"""Mean width of a letter in font sizes."""

PAPER, INK, SOFT, GRID, FADED = "#ffffff", "#2b2f36", "#5f656e", "#e4e6ea", "#8b9099"
_CATEGORIES = {
    "#0072b2": "#56a8e0",
    "#d55e00": "#ff8a4c",
    "#009e73": "#2fc79a",
    "#b4568d": "#e79cc4",
    "#b07900": "#f5bd41",
    "#3b93cc": "#9ad7ff",
    "#6b4fa0": "#b79ae0",
    "#6e6e6e": "#bdbdbd",
}
_VIRIDIS = ("#440154", "#46327e", "#365c8d", "#277f8e", "#1fa187", "#4ac16d", "#86c93a")
_VIRIDIS_DARK = ("#5b7fc7", "#3f9fb8", "#26b39a", "#44c878", "#86d95a", "#c3e34a", "#fdec5c")
_SHADES = 25


def _blend(anchors: tuple[str, ...], position: float) -> str:
    place = position * (len(anchors) - 1)
    low = min(int(place), len(anchors) - 2)
    one, other = (bytes.fromhex(anchor[1:]) for anchor in anchors[low : low + 2])
    return "#" + bytes(round(a + (b - a) * (place - low)) for a, b in zip(one, other, strict=True)).hex()


_SCALE = {_blend(_VIRIDIS, k / (_SHADES - 1)): _blend(_VIRIDIS_DARK, k / (_SHADES - 1)) for k in range(_SHADES)}
DARK = {
    **{PAPER: "#1c1f23", INK: "#e6e8eb", SOFT: "#a3a9b2", GRID: "#33373d", FADED: "#8b9099"},
    **_CATEGORIES,
    **_SCALE,
}
"""Every color of a figure, and what a dark page draws instead."""
SOLID = (1, 0)
_DASHES = (SOLID, (6, 3), (2, 2), (8, 3, 2, 3), (12, 3), (4, 2, 1, 2), (3, 4), (1, 3))
_SHAPES = ("circle", "square", "triangle-up", "diamond", "cross", "triangle-down", "triangle-right", "triangle-left")


@dataclass(frozen=True)
class Style:
    """Color, dash pattern and shape of one item."""

    color: str
    """One of `DARK`."""
    dash: tuple[int, ...] = SOLID
    """Lengths of dashes and gaps [px]."""
    shape: str = "circle"


def style(index: int) -> Style:
    """Return the style of the `index`-th unordered thing; they repeat after eight."""
    place = index % len(_CATEGORIES)
    return Style(list(_CATEGORIES)[place], _DASHES[place], _SHAPES[place])


def ordered_style(position: float) -> Style:
    """Return the style of an ordered thing, 0 for the least and 1 for the greatest: one of 25 shades."""
    colors = list(_SCALE)
    return Style(colors[round(min(max(position, 0.0), 1.0) * (len(colors) - 1))])


def text_width(letters: int, size: float = FONT_SIZE) -> int:
    """Return about how wide a text is, in px."""
    return round(LETTER * size * letters)


def config() -> dict[str, Any]:
    """Return the configuration of every Vega-Lite specification."""
    words = {"labelFontSize": FONT_SIZE, "titleFontSize": FONT_SIZE, "labelColor": INK, "titleColor": SOFT}
    words |= {"titleFontWeight": "normal", "labelLimit": 0, "titleLimit": 0}
    # The title of the upright axis lies level above it, where it can be read.
    level = {"titleAngle": 0, "titleAlign": "left", "titleBaseline": "bottom", "titleX": 0, "titleY": -20}
    return {
        "background": PAPER,
        "font": FONT,
        "padding": 12,
        "view": {"stroke": None},
        "title": {
            **{"anchor": "start", "frame": "bounds", "color": INK, "fontSize": TITLE_SIZE, "limit": 0, "offset": 12},
            **{"subtitleColor": SOFT, "subtitleFontSize": FONT_SIZE, "subtitleLineHeight": 15, "subtitlePadding": 6},
        },
        "axis": {**words, "gridColor": GRID, "domainColor": SOFT, "ticks": False, "labelPadding": 5, "titlePadding": 8},
        "axisY": {**level, "domain": False},
        "legend": {**words, "orient": "top", "title": None, "symbolSize": 70, "columnPadding": 18, "offset": 10},
    }
