"""Write a film as H.264 with the ffmpeg that imageio-ffmpeg brings along."""

from __future__ import annotations

import subprocess
import tempfile
from contextlib import suppress
from pathlib import Path
from typing import IO

import numpy as np
from numpy.typing import NDArray

from perdure.render.errors import RenderError


class Mp4Writer:
    """A film that is being written. `close` completes the file; call `abort` at the end in any case."""

    def __init__(self, path: Path, rate: float, *, crf: int = 20, preset: str = "medium") -> None:
        """Prepare a film; ffmpeg starts with the first picture.

        Args:
            path: The file, which is overwritten.
            rate: Pictures per second.
            crf: Quality of x264, from 0 (lossless) to 51.
            preset: Of x264: what it trades size for time by.
        """
        self._path = path
        self._options = ["-crf", str(crf), "-preset", preset, "-movflags", "+faststart", "-threads", "1"]
        self._rate = f"{rate:g}"
        self._process: subprocess.Popen[bytes] | None = None
        self._size = (0, 0)
        self._messages: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115  # open as long as the film; a pipe fills

    def add(self, picture: NDArray[np.uint8]) -> None:
        """Add a picture of shape (height, width, 3); width and height are even, and the same for every picture.

        Raises:
            RenderError: If ffmpeg has failed, for example because the disk is full.
        """
        height, width = picture.shape[:2]
        if self._process is None:
            self._start(width, height)
        if self._size != (width, height):
            expected = "{} x {}".format(*self._size)
            raise RenderError(f"a picture has {width} x {height} pixels, the first one {expected}")
        try:
            self._input.write(np.ascontiguousarray(picture).data)
        except OSError:
            self.close()  # says why ffmpeg has ended, unless it believes that all is well
            raise RenderError(f"ffmpeg ended before the film {self._path.name} was complete") from None

    def _start(self, width: int, height: int) -> None:
        import imageio_ffmpeg

        self._size = (width, height)
        command = [imageio_ffmpeg.get_ffmpeg_exe(), "-y", "-loglevel", "error", "-f", "rawvideo", "-pix_fmt", "rgb24"]
        command += ["-s", f"{width}x{height}", "-r", self._rate, "-i", "-", "-an", "-vcodec", "libx264"]
        command += ["-pix_fmt", "yuv420p", *self._options, f"file:{self._path}"]  # a colon is no protocol
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=self._messages, start_new_session=True
        )

    @property
    def _input(self) -> IO[bytes]:
        assert self._process is not None
        assert self._process.stdin is not None
        return self._process.stdin

    def close(self) -> None:
        """Complete the film.

        Raises:
            RenderError: If there was no picture, or ffmpeg has failed.
        """
        if self._process is None:
            raise RenderError("a film needs at least one picture")
        with suppress(OSError):
            self._input.close()
        if self._process.wait() != 0:
            self._messages.seek(0)
            said = self._messages.read().decode(errors="replace").strip().splitlines() or ["it gave no reason"]
            raise RenderError(f"ffmpeg could not write the film {self._path.name}: {said[0][:200]}")

    def abort(self) -> None:
        """Stop ffmpeg, if it still runs, and release what the writer holds."""
        if self._process is not None:
            if self._process.poll() is None:
                self._process.kill()
            with suppress(OSError):
                self._input.close()
            self._process.wait()
        self._messages.close()
