"""Text in pictures: names of targets and goals, the caption strip below a film, the title above it."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from perdure.home.sim.arrays import FloatArray, Picture
from perdure.home.video.cameras import Shot
from perdure.home.video.marks import Mark
from perdure.home.video.narrate import Caption

if TYPE_CHECKING:
    from PIL.ImageDraw import ImageDraw

Box = tuple[float, float, float, float]


@lru_cache(maxsize=16)
def font(size: float) -> Any:
    """Return Pillow's own font."""
    from PIL import ImageFont

    return ImageFont.load_default(size)


def write_labels(picture: Picture, shot: Shot, marks: Sequence[Mark], places: Sequence[FloatArray | None]) -> Picture:
    """Return a picture with the objects' names over their pins and `goal: ...` over the goals; labels do not overlap.

    The picture was rendered with that shot; `places` are where the marks' objects are.
    """
    from PIL import Image, ImageDraw

    image = Image.fromarray(picture)
    draw = ImageDraw.Draw(image)
    size, taken = image.size, list[Box]()
    for mark, place in zip(marks, places, strict=True):
        wanted = [(f"goal: {mark.label}", np.array(mark.goal) + np.array([0.0, 0.0, mark.radius]))]
        if place is not None:
            wanted.insert(0, (mark.label, place + np.array([0.0, 0.0, 0.50])))
        for text, point in wanted:
            x, y, depth = shot.project(point[None], size)[0]
            if depth > 0.0 and 0 <= x < size[0] and 0 <= y < size[1]:
                _label(draw, (float(x), float(y)), text, mark.color, taken, size)
    return np.asarray(image)


def _label(
    draw: ImageDraw,
    point: tuple[float, float],
    text: str,
    color: tuple[float, float, float],
    taken: list[Box],
    size: tuple[int, int],
) -> None:
    """Draw a plate with text, its lower edge above the point, moved up until it overlaps no other."""
    letters = font(max(11.0, size[1] / 42.0))
    left, top, right, bottom = draw.textbbox((0, 0), text, font=letters)
    width, height = right - left + 10, bottom - top + 7
    x = min(max(point[0] - 0.5 * width, 2.0), size[0] - width - 2.0)
    y = min(max(point[1] - height - 3.0, 2.0), size[1] - height - 2.0)
    for _ in range(20):
        hit = [b for b in taken if x < b[2] and b[0] < x + width and y < b[3] and b[1] < y + height]
        if not hit or y <= 2.0:
            break
        y = max(2.0, min(b[1] for b in hit) - height - 2.0)
    taken.append((x, y, x + width, y + height))
    plate = tuple(int(255 * part) for part in color)
    draw.rounded_rectangle((x, y, x + width, y + height), radius=4, fill=plate)
    draw.text((x + 5 - left, y + 3 - top), text, font=letters, fill="white")


STRIP = 64
"""Height of the strip below a film in pixels, for a film 720 pixels wide; it grows with the width."""
PAPER, INK, PALE = (250, 249, 246), (40, 40, 42), (176, 172, 164)
FAINT = (110, 108, 104)
DONE = (34, 139, 84)


def write_strip(picture: Picture, caption: Caption, speed: float) -> Picture:
    """Return a frame with a caption strip: skill and clock, and a mark for each stage, green once it is reached.

    `speed` is relative to real time. Shape (height, width, 3) -> (height + strip, width, 3).
    """
    from PIL import Image, ImageDraw

    height, width = picture.shape[:2]
    scale = width / 720.0
    image = Image.new("RGB", (width, height + strip_height(width)), PAPER)
    image.paste(Image.fromarray(picture), (0, 0))
    draw = ImageDraw.Draw(image)
    left, right = 12 * scale, width - 12 * scale
    large, small = font(19 * scale), font(14 * scale)
    draw.text((left, height + 17 * scale), caption.words, font=large, fill=INK, anchor="lm")
    pace = f"{speed:g} x real time" if speed != 1.0 else "real time"
    clock = f"skill {caption.number} of {caption.total}    {caption.seconds:5.1f} s    {pace}"
    draw.text((right, height + 17 * scale), clock, font=small, fill=INK, anchor="rm")
    _write_stages(draw, caption.stages, (left, height + 46 * scale, right), scale)
    return np.asarray(image)


TITLE = 44
"""Height of the title over a film in pixels, for a film 720 pixels wide."""


def write_title(picture: Picture, title: str, caption: str) -> Picture:
    """Return a frame with a title and a line of small print above it. Shape (height + title, width, 3)."""
    from PIL import Image

    height, width = picture.shape[:2]
    top = 2 * round(0.5 * TITLE * width / 720.0)
    image = Image.new("RGB", (width, height + top), PAPER)
    image.paste(Image.fromarray(_title(title, caption, width, top)), (0, 0))
    image.paste(Image.fromarray(picture), (0, top))
    return np.asarray(image)


@lru_cache(maxsize=16)
def _title(title: str, caption: str, width: int, height: int) -> Picture:
    from PIL import Image, ImageDraw

    scale = width / 720.0
    image = Image.new("RGB", (width, height), PAPER)
    draw = ImageDraw.Draw(image)
    draw.text((12 * scale, 14 * scale), title, font=font(18 * scale), fill=INK, anchor="lm")
    draw.text((12 * scale, 33 * scale), caption, font=font(13 * scale), fill=FAINT, anchor="lm")
    return np.asarray(image)


def strip_height(width: int) -> int:
    """Return the height of the strip below a film of a width; even, as films need it."""
    return 2 * round(0.5 * STRIP * width / 720.0)


def _write_stages(
    draw: ImageDraw, stages: Sequence[tuple[str, bool]], where: tuple[float, float, float], scale: float
) -> None:
    """Draw a row of dots with names, evenly spaced; `where` is (left, y, right) in pixels."""
    left, y, right = where
    pitch, radius = (right - left) / len(stages), 5.5 * scale
    letters = font(min(13.0, 78.0 / len(stages) + 4.0) * scale)
    for k, (name, done) in enumerate(stages):
        x = left + k * pitch + radius
        circle = (x - radius, y - radius, x + radius, y + radius)
        draw.ellipse(
            circle, fill=DONE if done else PAPER, outline=DONE if done else PALE, width=max(1, round(2 * scale))
        )
        draw.text(
            (x + radius + 4 * scale, y), name.replace("_", " "), font=letters, fill=INK if done else PALE, anchor="lm"
        )
