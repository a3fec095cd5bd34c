"""What a chart is, whatever draws it: series, bars, axes, markers. No renderer, no table in here."""

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
    """Names of rows 0, 1, 2, ... from top to bottom, or of columns from left to right: a list, not a scale."""

    @property
    def ticks(self) -> tuple[float, ...] | None:
        """Where its marks are; None: where the renderer likes. Shares end at 1, though the axis may go on."""
        beyond = self.percent and self.high is not None and self.high > 1.0
        return (0.0, 0.2, 0.4, 0.6, 0.8, 1.0) if beyond else None


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
class Bars:
    """Level bars in a chart with rows, one for each row of the arrays."""

    label: str
    """In the legend; empty: not in it."""
    rows: FloatArray
    """Where their middles are, shape (bars,): a row's number, or a little above or below it."""
    start: FloatArray
    """Left ends, shape (bars,)."""
    end: FloatArray
    """Right ends, shape (bars,)."""
    colour: Colour
    thickness: float = 0.7
    """In rows."""
    texts: tuple[str, ...] = ()
    """Written into the bars (left out where there is no room), or after them; one each, or none at all."""
    inside: bool = False
    """Whether texts stand in the bars."""
    pale: bool = False

    def __post_init__(self) -> None:
        for name in ("start", "end"):
            if np.shape(getattr(self, name)) != np.shape(self.rows):
                raise ReportError(f"Bars {self.label!r}: {name} and rows have different shapes.")
        if self.texts and len(self.texts) != len(self.rows):
            raise ReportError(f"Bars {self.label!r} have {len(self.texts)} texts for {len(self.rows)} bars.")


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
    bars: tuple[Bars, ...] = ()
    """Drawn before the series."""
    row_lines: int = 1
    """How many bars or points lie below each other in one row."""
    linked: bool = False
    """In a chart with rows: a pale line joins the first and the last series in every row."""
    note: str = ""
    """One or two sentences under the chart."""
    wide: bool = field(default=False)
    """Wants the whole width of the page."""
