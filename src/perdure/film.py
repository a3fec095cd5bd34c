"""Pictures of a MuJoCo simulation without a window, captions, and pictures and films as files.

`perdure watch` and the films of the home benchmark use it. Needs imageio-ffmpeg and Pillow: the extra `perdure[film]`.
"""

from __future__ import annotations

import io
import math
import os
import secrets
import subprocess
import sys
import tempfile
from collections.abc import Callable, Generator, Iterable, Sequence
from contextlib import contextmanager, suppress
from functools import lru_cache
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from perdure.errors import PerdureError
from perdure.runs import refuse_replacing, write_atomic

Picture = NDArray[np.uint8]
"""Red, green and blue from 0 to 255. Shape (height, width, 3)."""
Color = tuple[int, int, int]
Row = tuple[int, Sequence[tuple[str, Color]]]
"""A line of text: the font size in pixels, and texts with their colors in columns of equal width."""

PAPER = (255, 255, 255)
INK = (20, 20, 20)
GRAY = (110, 110, 110)
PALE = (170, 170, 170)
GREEN = (0, 110, 60)
RED = (178, 34, 34)
AMBER = (255, 170, 0)
MARGIN = 8
"""Pixels between a text and the edge of the picture, and between two columns."""
SMALLEST_FONT = 7
GAP = 8
"""Pixels between two pictures side by side; even, as films need it."""
SUPERSAMPLING = 2
"""Pictures are drawn as many times wider and higher, and averaged: samples of OpenGL leave edges of shadows rough."""
SUFFIXES = (".mp4", ".gif", ".webp")
"""A WebP is smaller than a GIF, and pages on GitHub show it, unlike an MP4."""
WEBP = {"quality": 40, "minimize_size": True, "method": 4}
OFF = ("disable", "disabled", "off", "false", "0")
"""Values of MUJOCO_GL that switch rendering off."""


def check_film(path: Path, suffixes: Sequence[str] = SUFFIXES) -> None:
    """Raise PerdureError for a file that exists or has none of these suffixes, or without imageio-ffmpeg and Pillow."""
    if path.suffix.lower() not in suffixes:
        kind = "a film" if ".mp4" in suffixes else "a picture"
        raise PerdureError(f"{kind} is written as {', '.join(suffixes)}, not as {path.name}")
    needed = {"PIL": "pillow", "imageio_ffmpeg": "imageio-ffmpeg"}
    missing = [name for module, name in needed.items() if not find_spec(module)]
    if missing:
        raise PerdureError(f"films and pictures need {' and '.join(missing)}: pip install 'perdure[film]'")
    refuse_replacing(path)


def open_context(width: int, height: int) -> Any:
    """Return an OpenGL context that is current in this thread, for pictures up to a size in pixels.

    MUJOCO_GL decides if it is `egl`, `osmesa` or `glfw`; else, on Linux, the first of EGL (the graphics card, or Mesa)
    and OSMesa (the processor) that works. `mujoco.Renderer` would open a window there.

    Raises:
        PerdureError: If none of them works here, or MUJOCO_GL switches pictures off.
    """
    wanted = os.environ.get("MUJOCO_GL", "").lower().strip()
    if wanted in OFF:
        raise PerdureError(f"no picture can be drawn: MUJOCO_GL={wanted} switches pictures off")
    if wanted in ("egl", "osmesa", "glfw"):
        modules = [f"mujoco.{wanted}"]
    elif sys.platform.startswith("linux"):
        modules = ["mujoco.egl", "mujoco.osmesa"]
    else:
        modules = ["mujoco"]
    failures = []
    for module in modules:
        try:
            context = import_module(module).GLContext(width, height)
            context.make_current()
        except Exception as error:  # every driver has its own way to fail
            first_line = str(error).partition("\n")[0].strip()
            reason = f"{type(error).__name__}: {first_line}"
            failures.append(f"{module.removeprefix('mujoco.')} ({reason[:120]})")
            _forget_opengl()
        else:
            return context
    raise PerdureError(f"no picture can be drawn here: {'; '.join(failures)}; on Debian, install libegl1 or libosmesa6")


def _forget_opengl() -> None:
    """PyOpenGL binds to one platform when it is first imported; the next candidate needs another one."""
    os.environ.pop("PYOPENGL_PLATFORM", None)
    for name in list(sys.modules):
        if name.partition(".")[0] == "OpenGL" or name.startswith(("mujoco.egl", "mujoco.osmesa", "mujoco.glfw")):
            del sys.modules[name]


class Renderer:
    """Draws one model. Use it as a context manager in the thread that made it.

    Args:
        model: A copy of the simulation's `MjModel`; its visual settings are changed.
        size: Width and height of a picture in pixels.
        supersampling: See `SUPERSAMPLING`; that by default.

    Raises:
        PerdureError: If no picture can be drawn on this machine.
    """

    shadows: ClassVar[int] = 1024
    """Size of the shadow map in texels."""

    def __init__(self, model: Any, size: tuple[int, int], supersampling: int | None = None) -> None:
        import mujoco

        self._mujoco = mujoco
        self.model = model
        self.size = size
        self._supersampling = supersampling or SUPERSAMPLING
        self._drawn = (self._supersampling * size[0], self._supersampling * size[1])
        width, height = self._drawn
        model.vis.global_.offwidth = width
        model.vis.global_.offheight = height
        model.vis.quality.shadowsize = self.shadows
        model.vis.quality.offsamples = 0
        self._context = open_context(width, height)
        self._drawing = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100.value)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, self._drawing)
        self.scene = mujoco.MjvScene(model, maxgeom=model.ngeom + 200)
        self.options = mujoco.MjvOption()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self._context.make_current()
        self._drawing.free()
        self._context.free()

    def draw(self, data: Any, camera: Any, decorate: Callable[[], None] | None = None) -> Picture:
        """Return a picture of a state (`MjData`), seen from an `MjvCamera`; `decorate` may add to `scene` before."""
        from PIL import Image

        m = self._mujoco
        everything = m.mjtCatBit.mjCAT_ALL.value
        self._context.make_current()
        m.mjv_updateScene(self.model, data, self.options, None, camera, everything, self.scene)
        if decorate is not None:
            decorate()
        width, height = self._drawn
        picture: Picture = np.empty((height, width, 3), np.uint8)
        view = m.MjrRect(0, 0, width, height)
        m.mjr_render(view, self.scene, self._drawing)
        m.mjr_readPixels(picture, None, view, self._drawing)
        return np.asarray(Image.fromarray(picture[::-1]).reduce(self._supersampling))


def annotate(
    picture: Picture, above: Sequence[Row] = (), below: Sequence[Row] = (), edge: Color | None = None
) -> Picture:
    """Return a picture with lines of text above and below it, and perhaps a colored edge.

    A line with a text that is too long for its column is written smaller. The strips are `strip_height` pixels high.
    """
    from PIL import Image, ImageDraw

    height, width = picture.shape[:2]
    top = strip_height(above)
    image = Image.new("RGB", (width, top + height + strip_height(below)), PAPER)
    image.paste(Image.fromarray(picture), (0, top))
    draw = ImageDraw.Draw(image)
    for rows, start in ((above, 0), (below, top + height)):
        y = start + 3.0
        for size, cells in rows:
            pitch = (width - MARGIN) / len(cells)
            font = _fitting_font(draw, [text for text, _ in cells], pitch - MARGIN, size)
            for column, (text, color) in enumerate(cells):
                draw.text((MARGIN + column * pitch, y + 0.7 * size), text, fill=color, font=font, anchor="lm")
            y += 1.4 * size
    if edge is not None:
        draw.rectangle((0, top, width - 1, top + height - 1), outline=edge, width=5)
    return np.asarray(image)


def write_labels(picture: Picture, labels: Sequence[tuple[float, float, str, Color]], size: int = 13) -> Picture:
    """Return a picture with texts above points (x, y) in it; a text that would cover another one is moved up."""
    from PIL import Image, ImageDraw

    image = Image.fromarray(picture)
    draw = ImageDraw.Draw(image)
    taken: list[NDArray[np.float64]] = []
    for x, y, text, color in sorted(labels, key=lambda label: -label[1]):
        if 0 <= x < image.width and 0 <= y < image.height:
            box = np.array(draw.textbbox((x, y), text, font=_font(size), anchor="mb"), float)
            box[::2] += max(-box[0], 0.0) - max(box[2] - image.width, 0.0)
            while any((box[:2] < other[2:] + 2).all() and (other[:2] < box[2:] + 2).all() for other in taken):
                box[1::2] -= 1.0
            taken.append(box)
            if box[1] >= 0.0:  # else no room is left for it
                draw.text(tuple(box[:2]), text, color, _font(size), "lt", stroke_width=2, stroke_fill=PAPER)
    return np.asarray(image)


def strip_height(rows: Sequence[Row]) -> int:
    """Return the height of lines of text above or below a picture in pixels; even, as films need it."""
    if not rows:
        return 0
    return 2 * math.ceil(0.5 * (6.0 + sum(1.4 * size for size, _ in rows)))


@lru_cache(maxsize=64)
def _font(size: int) -> Any:
    from PIL import ImageFont

    return ImageFont.load_default(size)  # Pillow's own font, the same on every machine


def _fitting_font(draw: Any, texts: Sequence[str], width: float, size: int) -> Any:
    while size > SMALLEST_FONT and max(draw.textlength(text, font=_font(size)) for text in texts) > width:
        size -= 1
    return _font(size)


def tile(pictures: Sequence[Picture], columns: int, gap: int = GAP) -> Picture:
    """Return pictures of one size row by row on white paper, a gap in pixels between them."""
    height, width = pictures[0].shape[:2]
    rows = math.ceil(len(pictures) / columns)
    sheet = np.full((rows * (height + gap) - gap, columns * (width + gap) - gap, 3), 255, dtype=np.uint8)
    for k, picture in enumerate(pictures):
        row, column = divmod(k, columns)
        y = row * (height + gap)
        x = column * (width + gap)
        sheet[y : y + height, x : x + width] = picture
    return sheet


def save_picture(picture: Picture, path: Path, colors: int | None = None) -> Path:
    """Write a picture as `.png`, small with a number of `colors`; return the path."""
    check_film(path, (".png",))
    from PIL import Image

    image = Image.fromarray(picture)
    if colors is not None:
        image = image.quantize(colors, dither=Image.Dither.NONE)
    box = io.BytesIO()
    image.save(box, "PNG", optimize=True)
    return write_atomic(path, box.getvalue())


def write_film(pictures: Iterable[Picture], path: Path, rate: float) -> int:
    """Write pictures of one even size as a film, and return how many. A film that breaks off leaves no file.

    Args:
        pictures: At least one.
        path: The file, with one of `SUFFIXES`.
        rate: Pictures per second.

    Raises:
        PerdureError: If the name is not that of a film, there is no picture, or ffmpeg fails.
    """
    check_film(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.stem}.{secrets.token_hex(4)}{path.suffix.lower()}")
    temporary.touch()  # a folder that may not be written is found out before the first picture
    count = 0
    try:
        write = _mp4 if temporary.suffix == ".mp4" else _animation
        with write(temporary, rate) as add:
            for picture in pictures:
                add(picture)
                count += 1
            if not count:
                raise PerdureError("a film needs at least one picture")
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)
    return count


@contextmanager
def _mp4(path: Path, rate: float) -> Generator[Callable[[Picture], object], None, None]:
    """Write H.264 with the ffmpeg of imageio-ffmpeg; its `write_frames` does not look at ffmpeg's exit code."""
    import imageio_ffmpeg

    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-y", "-loglevel", "error", "-f", "image2pipe", "-c:v", "ppm"]
    command += ["-framerate", f"{rate:g}", "-i", "-", "-c:v", "libx264", "-pix_fmt", "yuv420p", "-crf", "20"]
    command += ["-movflags", "+faststart", "-threads", "1", f"file:{path}"]  # a colon in a name is no protocol
    with (
        tempfile.TemporaryFile() as messages,  # a pipe could fill
        subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=messages, start_new_session=True
        ) as ffmpeg,
    ):
        assert ffmpeg.stdin is not None
        pipe = ffmpeg.stdin
        broken = False

        def add(picture: Picture) -> None:
            height, width = picture.shape[:2]
            pipe.write(b"P6 %d %d 255\n" % (width, height) + picture.tobytes())

        try:
            yield add
            pipe.close()
        except BrokenPipeError:
            broken = True
        except BaseException:
            ffmpeg.kill()
            raise
        finally:
            with suppress(OSError):
                pipe.close()
        if ffmpeg.wait() or broken:
            messages.seek(0)
            said = messages.read().decode(errors="replace").strip().splitlines() or ["it gave no reason"]
            raise PerdureError(f"ffmpeg could not write the film: {said[0][:200]}")


@contextmanager
def _animation(path: Path, rate: float) -> Generator[Callable[[Picture], object], None, None]:
    """Write a GIF of 128 colors, or a WebP, with Pillow."""
    from PIL import Image

    pictures: list[Any] = []
    options: dict[str, Any] = {"optimize": False}
    if path.suffix == ".webp":
        options = WEBP

    def add(picture: Picture) -> None:
        image = Image.fromarray(picture)
        if path.suffix != ".webp":
            image = image.quantize(128, dither=Image.Dither.NONE)
        pictures.append(image)

    yield add
    ends = [10 * round(100 * k / rate) for k in range(len(pictures) + 1)]  # [ms]; GIF counts in hundredths of a second
    durations = np.diff(ends).tolist()
    pictures[0].save(path, save_all=True, append_images=pictures[1:], duration=durations, loop=0, **options)
