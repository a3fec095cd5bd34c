"""Captions above and below the frames of a video."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from perdure.extrapolate.film.camera import Picture

TOP, BOTTOM, GAP = 52, 34, 8
"""Heights of the strips and width between two pictures, in pixels; even, as films want it."""
PAPER, INK, GRAY = (255, 255, 255), (20, 20, 20), (110, 110, 110)
COLORS = {"holds": (0, 110, 60), "": INK}
FAILED = (178, 34, 34)


@dataclass(frozen=True)
class Caption:
    """Text of one panel."""

    title: str
    """First line over the picture, in the outcome's color."""
    subtitle: str
    below: str
    outcome: str
    """"holds", another outcome, or "" for neither."""
    failed: bool
    """Whether the failure has happened by now: the panel gets a frame."""


def compose(panels: Sequence[tuple[Picture, Caption]]) -> Picture:
    """Return panels side by side; width and height are even."""
    written = [_panel(picture, caption) for picture, caption in panels]
    gap: Picture = np.full((written[0].shape[0], GAP, 3), 255, np.uint8)
    parts = [part for panel in written for part in (gap, panel)][1:]
    return np.ascontiguousarray(np.concatenate(parts, axis=1))


def _panel(picture: Picture, caption: Caption) -> Picture:
    from PIL import Image, ImageDraw

    height, width = picture.shape[:2]
    image = Image.new("RGB", (width, height + TOP + BOTTOM), PAPER)
    image.paste(Image.fromarray(picture), (0, TOP))
    draw = ImageDraw.Draw(image)
    color = COLORS.get(caption.outcome, FAILED)
    draw.text((8, 5), caption.title, fill=color, font=_fitting(draw, caption.title, width - 16, 20))
    draw.text((8, 31), caption.subtitle, fill=GRAY, font=_fitting(draw, caption.subtitle, width - 16, 14))
    draw.text((8, TOP + height + 8), caption.below, fill=INK, font=_fitting(draw, caption.below, width - 16, 15))
    if caption.failed:
        draw.rectangle((0, TOP, width - 1, TOP + height - 1), outline=FAILED, width=5)
    return np.asarray(image)


@lru_cache(maxsize=64)
def _font(size: int) -> Any:
    from PIL import ImageFont

    return ImageFont.load_default(size)


def _fitting(draw: Any, text: str, width: int, size: int) -> Any:
    """Return the largest font, up to a size, in which the text fits the width."""
    while size > 8 and draw.textlength(text, font=_font(size)) > width:
        size -= 1
    return _font(size)
