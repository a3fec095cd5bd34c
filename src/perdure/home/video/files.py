"""Pictures and films as files, written whole: PNG, MP4 and GIF."""

from __future__ import annotations

import io
import os
import secrets
from collections.abc import Callable, Generator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Protocol

from perdure.home.errors import HomeError
from perdure.home.sim.arrays import Picture
from perdure.render import Mp4Writer, RenderError
from perdure.runs import write_atomic

GIF_PACE = 0.08
"""Seconds that a picture of a GIF stays: browsers count in hundredths and slow down what is faster."""
MP4_PACE = 1.0 / 30.0


class Film(Protocol):
    """A film that is being written."""

    pace: float
    """Seconds that each picture stays."""

    def add(self, picture: Picture) -> None:
        """The next picture; all must have the same even width and height."""

    def end(self) -> None:
        """The film is complete."""

    def stop(self) -> None:
        """Stop writing."""


def save_picture(picture: Picture, path: Path, colors: int | None = None) -> Path:
    """Write a picture (height, width, 3) as `.png`, small with a number of `colors`."""
    from PIL import Image

    if path.suffix.lower() != ".png":
        raise HomeError(f"a picture is written as .png, not as {path.name}")
    image = Image.fromarray(picture)
    if colors is not None:
        image = image.quantize(colors, dither=Image.Dither.NONE)
    box = io.BytesIO()
    image.save(box, "PNG", optimize=True)
    return write_atomic(path, box.getvalue())


@contextmanager
def open_film(path: Path) -> Generator[Film, None, None]:
    """A film to add pictures to; the file appears when the block ends well.

    Raises:
        HomeError: For a name that ends neither in `.mp4` nor in `.gif`.
        RenderError: When a film can't be written.
    """
    kinds: dict[str, Callable[[Path], Film]] = {".mp4": _Mp4, ".gif": _Gif}
    if path.suffix.lower() not in kinds:
        raise HomeError(f"a film is written as .mp4 or .gif, not as {path.name}")
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.stem}.{secrets.token_hex(4)}{path.suffix.lower()}")
    temporary.touch()  # a folder that may not be written is found out now, not after the episode
    film = kinds[path.suffix.lower()](temporary)
    try:
        yield film
        film.end()
        with temporary.open("rb") as written:
            os.fsync(written.fileno())
        os.replace(temporary, path)
    finally:
        film.stop()
        with suppress(FileNotFoundError):
            temporary.unlink()


class _Mp4:
    """H.264."""

    pace = MP4_PACE

    def __init__(self, path: Path) -> None:
        self._writer = Mp4Writer(path, round(1.0 / self.pace), crf=23, preset="veryfast")

    def add(self, picture: Picture) -> None:
        self._writer.add(picture)

    def end(self) -> None:
        self._writer.close()

    def stop(self) -> None:
        self._writer.abort()


class _Gif:
    """A GIF by Pillow, 128 colors."""

    pace = GIF_PACE

    def __init__(self, path: Path) -> None:
        self._path = path
        self._pictures: list[Any] = []

    def add(self, picture: Picture) -> None:
        from PIL import Image

        self._pictures.append(Image.fromarray(picture).quantize(128, dither=Image.Dither.NONE))

    def end(self) -> None:
        if not self._pictures:
            raise RenderError("a film needs at least one picture")
        first, *rest = self._pictures
        first.save(
            self._path, save_all=True, append_images=rest, duration=round(1000 * self.pace), loop=0, optimize=False
        )

    def stop(self) -> None:
        self._pictures.clear()
