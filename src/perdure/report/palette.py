"""Colours that stay apart for colour-blind eyes, each in a light and a dark version of the page.

Categories follow Okabe and Ito, "Color Universal Design" (2008); the scale for the constant C follows viridis (Smith
and van der Walt, 2015), cut where it would vanish into the background.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Colour:
    """One colour as #rrggbb on a light and on a dark background."""

    light: str
    dark: str


INK = Colour("#3b3f46", "#d5d8dd")
FADED = Colour("#8b9099", "#7d838c")
CATEGORIES = (
    Colour("#0072b2", "#56a8e0"),
    Colour("#d55e00", "#ff8a4c"),
    Colour("#009e73", "#2fc79a"),
    Colour("#b4568d", "#e79cc4"),
    Colour("#c98a00", "#f5bd41"),
    Colour("#4aa3dc", "#9ad7ff"),
    Colour("#6b4fa0", "#b79ae0"),
    Colour("#6e6e6e", "#bdbdbd"),
)
_VIRIDIS_LIGHT = ("#440154", "#46327e", "#365c8d", "#277f8e", "#1fa187", "#4ac16d", "#86c93a")
_VIRIDIS_DARK = ("#5b7fc7", "#3f9fb8", "#26b39a", "#44c878", "#86d95a", "#c3e34a", "#fdec5c")


def category(index: int) -> Colour:
    """Return the colour of the `index`-th unordered thing; they repeat after eight."""
    return CATEGORIES[index % len(CATEGORIES)]


def scale(position: float) -> Colour:
    """Return the colour of an ordered thing at `position`, 0 for the least and 1 for the greatest."""
    return Colour(_blend(_VIRIDIS_LIGHT, position), _blend(_VIRIDIS_DARK, position))


def _blend(anchors: tuple[str, ...], position: float) -> str:
    place = min(max(position, 0.0), 1.0) * (len(anchors) - 1)
    low = min(int(place), len(anchors) - 2)
    part = place - low
    pairs = zip(_channels(anchors[low]), _channels(anchors[low + 1]), strict=True)
    return "#" + "".join(f"{round(a + (b - a) * part):02x}" for a, b in pairs)


def _channels(colour: str) -> tuple[int, int, int]:
    return int(colour[1:3], 16), int(colour[3:5], 16), int(colour[5:7], 16)
