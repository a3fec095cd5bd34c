"""What a chart is, whatever draws it: series, axes, markers. No renderer, no table in here."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from perdure.report.errors import ReportError
from perdure.report.palette import Colour

FloatArray = NDArray[np.float64]
Dash = Literal["solid", "dash", "dot", "dashdot"]


@dataclass(frozen=True)
class Axis:
    """One axis."""

    title: str
    log: bool = False
    percent: bool = False
    """The values are shares, written in percent."""
    low: float | None = None
    """Where the axis begins; None: as the data wants."""
    high: float | None = None
    rows: tuple[str, ...] = ()
    """Names of rows 0, 1, 2, ... from top to bottom: the axis is a list, not a scale."""


@dataclass(frozen=True)
class Series:
    """Points, perhaps joined by a line, perhaps within an interval."""

    label: str
    x: FloatArray
    """Shape (points,)."""
    y: FloatArray
    colour: Colour
    lower: FloatArray | None = None
    """Lower bounds of y; of x in a chart with rows. nan: no interval there."""
    upper: FloatArray | None = None
    dash: Dash = "solid"
    line: bool = True
    points: bool = False
    hollow: bool = False
    """Points are rings."""
    group: str = ""
    """Heading in the legend."""
    tag: str = ""
    """Short name written at the end of the curve."""

    def __post_init__(self) -> None:
        for name in ("y", "lower", "upper"):
            values = getattr(self, name)
            if values is not None and np.shape(values) != np.shape(self.x):
                raise ReportError(f"Series {self.label!r}: {name} has shape {np.shape(values)}, x {np.shape(self.x)}.")
        if (self.lower is None) != (self.upper is None):
            raise ReportError(f"Series {self.label!r} has one bound only: give both or none.")


@dataclass(frozen=True)
class Marker:
    """A vertical line with a label."""

    at: float
    label: str


@dataclass(frozen=True)
class Chart:
    """One chart."""

    name: str
    """For files and anchors: letters, digits, dashes."""
    title: str
    x: Axis
    y: Axis
    series: tuple[Series, ...]
    markers: tuple[Marker, ...] = ()
    note: str = ""
    """One or two sentences under the chart."""
    wide: bool = field(default=False)
    """Wants the whole width of the page."""
