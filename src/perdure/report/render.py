"""A figure, and its one Vega-Lite specification as PNG, SVG, PDF, or drawn by Vega in a page.

The specification holds the data, so that each of these shows the same. The same figure gives the same specification,
PNG and SVG, byte for byte; a PDF holds the time at which it was made.
"""

from __future__ import annotations

import json
import re
import struct
import textwrap
import zlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args

from perdure.report import theme
from perdure.report.errors import ReportError
from perdure.runs import write_atomic

if TYPE_CHECKING:
    import altair as alt

Format = Literal["png", "svg", "pdf"]
FORMATS: tuple[Format, ...] = get_args(Format)
_NAME = re.compile(r"[a-z0-9]+([-_][a-z0-9]+)*")


@dataclass(frozen=True)
class Figure:
    """A chart with its title and note."""

    name: str
    """For files and anchors: lower-case letters and digits, dashes between them, see `slug`."""
    title: str
    """What is seen."""
    chart: alt.LayerChart | alt.HConcatChart
    note: str = ""
    """Sentences: what intervals are, and over how many."""
    heading: str = ""
    """Such as the task: written before the title where a picture stands alone."""
    wide: bool = False
    """Whether the figure needs the whole width of a page."""

    def __post_init__(self) -> None:
        if _NAME.fullmatch(self.name) is None:
            raise ReportError(f"A figure cannot be named {self.name!r}: letters a to z, digits and dashes; see slug.")

    @cached_property
    def spec(self) -> dict[str, Any]:
        """The Vega-Lite specification, without title and note."""
        return {**self.chart.to_dict(), "config": theme.config()}

    def standalone(self) -> dict[str, Any]:
        """Return the specification of a picture that stands alone: heading, title and note above the chart."""
        width = theme.WIDE if self.wide else theme.WIDTH
        letters = round(width / theme.text_width(100) * 100)
        big = round(width / theme.text_width(100, theme.TITLE_SIZE * 1.15) * 100)
        title = ": ".join(filter(None, (self.heading, self.title)))
        lines = {"text": textwrap.wrap(title, big), "subtitle": textwrap.wrap(self.note, letters)}
        return {**self.spec, "title": lines}


def render(figure: Figure, kind: Format = "png") -> bytes:
    """Return a figure as the bytes of a file.

    Args:
        figure: What to draw.
        kind: "png", "svg" or "pdf".

    Raises:
        ReportError: Another format.
    """
    import vl_convert

    if kind not in FORMATS:
        raise ReportError(f"A figure cannot be written as {kind!r}; formats are {', '.join(FORMATS)}.")
    how: Any = {"vl_version": _version(), "allowed_base_urls": []}
    if kind == "png":
        return _deflate(bytes(vl_convert.vegalite_to_png(figure.standalone(), scale=theme.PNG_SCALE, **how)))
    if kind == "pdf":
        return bytes(vl_convert.vegalite_to_pdf(figure.standalone(), **how))
    return str(vl_convert.vegalite_to_svg(figure.standalone(), **how)).encode()


def _deflate(png: bytes) -> bytes:
    """Compress a PNG again: vl-convert's own is 2.5 times as large (measured)."""
    head, pixels, place = png[:33], b"", 33  # signature and header
    while place < len(png):
        (size,) = struct.unpack(">I", png[place : place + 4])
        if png[place + 4 : place + 8] == b"IDAT":
            pixels += png[place + 8 : place + 8 + size]
        place += 12 + size
    parts = (b"IDAT" + zlib.compress(zlib.decompress(pixels), 6), b"IEND")
    return head + b"".join(struct.pack(">I", len(p) - 4) + p + struct.pack(">I", zlib.crc32(p)) for p in parts)


def save(figures: Iterable[Figure], folder: Path, formats: Sequence[Format] = ("png",)) -> None:
    """Write figures as files named after them into a folder.

    Raises:
        ReportError: An unknown format.
        OSError: A file cannot be written.
    """
    for figure in figures:
        for kind in formats:
            write_atomic(folder / f"{figure.name}.{kind}", render(figure, kind))


def unique(figures: Iterable[Figure], taken: set[str]) -> list[Figure]:
    """Return figures with a number behind each name that is in `taken` already; names are added to it."""
    found = []
    for figure in figures:
        name, number = figure.name, 2
        while name in taken:
            name, number = f"{figure.name}-{number}", number + 1
        taken.add(name)
        found.append(replace(figure, name=name))
    return found


@cache
def javascript() -> str:
    """Return Vega, Vega-Lite and Vega-Embed as one script that needs no network."""
    import vl_convert

    bundle: Any = vl_convert.javascript_bundle  # its stub demands a snippet, which it does not need
    return str(bundle(vl_version=_version()))


def script_json(value: Any) -> str:
    """Return JSON that may stand in an HTML script element: nothing in it can end the element."""
    return json.dumps(value, allow_nan=False, separators=(",", ":"), ensure_ascii=False).replace("<", "\\u003c")


def slug(*words: str) -> str:
    """Convert words to a file name that is valid on all systems."""
    return re.sub(r"[^a-z0-9]+", "-", " ".join(words).lower()).strip("-")[:80].strip("-") or "figure"


def _version() -> str:
    """Return the version of Vega-Lite for which Altair writes, such as "6.4", or the newest older one that is there.

    Raises:
        ReportError: vl-convert holds no version that is old enough.
    """
    import altair as alt
    import vl_convert

    wanted = _numbers(alt.SCHEMA_VERSION.removeprefix("v"))
    known = {_numbers(version): version for version in vl_convert.get_vegalite_versions()}
    fitting = [each for each in known if each <= wanted]
    if not fitting:
        raise ReportError(
            f"altair writes for Vega-Lite {alt.SCHEMA_VERSION}; vl-convert-python holds {', '.join(known.values())}: "
            "pip install --upgrade altair vl-convert-python"
        )
    return known[max(fitting)]


def _numbers(version: str) -> tuple[int, ...]:
    return tuple(int(part) for part in version.split(".")[:2])
