"""Write a film whole: a failed write leaves no file."""

from __future__ import annotations

import os
import secrets
from collections.abc import Iterable
from importlib.util import find_spec
from pathlib import Path

from perdure.extrapolate.film.camera import Picture
from perdure.extrapolate.film.errors import FilmError
from perdure.render import Mp4Writer

SUFFIX = ".mp4"


def check_film(path: Path) -> None:
    """Refuse a name that is no film's, and a machine that cannot write one, before anything is simulated.

    Raises:
        FilmError: If the name does not end in .mp4, or imageio-ffmpeg or Pillow is missing.
    """
    if path.suffix.lower() != SUFFIX:
        raise FilmError(f"a film is written as {SUFFIX}, not as {path.name}")
    missing = [
        name for module, name in (("imageio_ffmpeg", "imageio-ffmpeg"), ("PIL", "pillow")) if not find_spec(module)
    ]
    if missing:
        raise FilmError(f"films need {' and '.join(missing)}: pip install 'perdure[film]'")


def write_film(pictures: Iterable[Picture], path: Path, rate: float) -> int:
    """Write pictures of one even size; return how many.

    Args:
        pictures: At least one.
        path: The file.
        rate: Pictures per second.

    Raises:
        RenderError: If there is no picture, or ffmpeg fails.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.stem}.{secrets.token_hex(4)}{SUFFIX}")
    temporary.touch()  # a folder that may not be written is found out before the first picture
    writer, count = Mp4Writer(temporary, rate), 0
    try:
        for picture in pictures:
            writer.add(picture)
            count += 1
        writer.close()
        os.replace(temporary, path)
    finally:
        writer.abort()
        temporary.unlink(missing_ok=True)
    return count
