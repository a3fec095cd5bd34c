"""Frames of a film that wait on disk until the films beside them are complete."""

from __future__ import annotations

import io
import tempfile
from typing import Self

import numpy as np

from perdure.home.sim.arrays import Picture

QUALITY = 95


class FrameBuffer:
    """A context manager that keeps compressed frames in a temporary file; a whole task would not fit into memory."""

    def __init__(self, pace: float) -> None:
        """Open an empty buffer; `pace` is how many seconds each picture stays."""
        self.pace = pace
        self._file = tempfile.TemporaryFile()  # noqa: SIM115 - closed by `stop`
        self._ends = [0]

    def __enter__(self) -> Self:
        """Return itself."""
        return self

    def __exit__(self, *error: object) -> None:
        """See `stop`."""
        self.stop()

    def __len__(self) -> int:
        """Return the number of frames."""
        return len(self._ends) - 1

    def add(self, picture: Picture) -> None:
        """See `Film.add`."""
        from PIL import Image

        box = io.BytesIO()
        Image.fromarray(picture).save(box, "JPEG", quality=QUALITY, subsampling=0)
        self._file.seek(self._ends[-1])
        self._file.write(box.getvalue())
        self._ends.append(self._file.tell())

    def end(self) -> None:
        """See `Film.end`."""

    def stop(self) -> None:
        """Discard the frames."""
        self._file.close()

    def picture(self, number: int) -> Picture:
        """Return the frame of a number, the last one for any number beyond it. Shape (height, width, 3)."""
        from PIL import Image

        number = min(number, len(self) - 1)
        first, last = self._ends[number : number + 2]
        self._file.seek(first)
        return np.asarray(Image.open(io.BytesIO(self._file.read(last - first))))
