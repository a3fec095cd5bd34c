"""Shared parts of figures: axis titles, styles, and data as plain values."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from perdure.report import theme
from perdure.report.errors import ReportError
from perdure.report.theme import Style

if TYPE_CHECKING:
    import altair as alt

FloatArray = NDArray[np.float64]

_DIGITS = 6


@dataclass(frozen=True)
class Axis:
    """Quantity and range of one axis."""

    title: str
    """In words, with the unit and n."""
    log: bool = False
    percent: bool = False
    """The values are shares, written in percent; the axis goes from 0 to 1."""
    low: float | None = None
    """Where the axis begins; None: as the data want."""
    high: float | None = None
    names: tuple[str, ...] = ()
    """Names of the places 0, 1, 2, ...: a list, not a scale."""

    def bounds(self, values: Sequence[float]) -> tuple[float, float]:
        """Return the ends of the axis: 0 is included unless the axis is logarithmic or sets its own limits."""
        low, high = (0.0, 1.0) if self.percent else (min(values, default=0.0), max(values, default=1.0))
        if not (self.percent or self.log):
            low, high = min(low, 0.0), max(high, 0.0)
            margin = 0.04 * (high - low or 1.0)
            low, high = low - margin * (low < 0.0), high + margin
        low, high = low if self.low is None else self.low, high if self.high is None else self.high
        return low, high if high > low else low + 1.0

    def place(self, value: float, values: Sequence[float]) -> float:
        """Return where a value lies between the ends of the axis, 0 and 1."""
        ends = np.array([*self.bounds(values), value])
        low, high, at = np.log(ends) if self.log else ends
        return float((at - low) / (high - low))

    def scale(self, values: Sequence[float]) -> alt.Scale:
        """Return the scale for these values."""
        import altair as alt

        if self.names:
            return alt.Scale(domain=list(self.names))
        return alt.Scale(type="log" if self.log else "linear", domain=list(self.bounds(values)), nice=False)

    def ticks(self, high: float, grid: bool, values: Sequence[float] = ()) -> alt.Axis:
        """Return the marks of an axis whose values reach `high`; at `values` where they are given."""
        import altair as alt

        style: dict[str, Any] = {"grid": grid, "labelFlush": False, "tickCount": 6}
        if self.names:
            style |= {"labelAngle": 0, "labelOverlap": False}
        elif self.percent:
            values = values or (0.0, 0.2, 0.4, 0.6, 0.8, 1.0)
            style |= {"labelExpr": "format(100 * datum.value, '~g') + ' %'"}
        elif self.log:
            low = self.low or high / 1e3
            first, last = math.ceil(math.log10(low) - 1e-9), math.floor(math.log10(high) + 1e-9)
            values = [10.0**k for k in range(first, last + 1)]
            values += [high] if values and high >= 2.0 * values[-1] else []
            style |= {"format": ",.0f" if low >= 1.0 else "~g"}
        elif high >= 10_000.0:
            style |= {"labelExpr": "format(datum.value, '~s')"}
        style |= {"values": list(values)} if values else {}
        return alt.Axis(**style)

    def channel(self, kind: Any, field: str, values: Sequence[float], grid: bool = False) -> Any:
        """Return a position channel.

        Args:
            kind: `alt.X` or `alt.Y`.
            field: Of the data.
            values: All that must find room.
            grid: Whether lines go through the figure at the marks.
        """
        high = self.bounds(values)[1]
        title, axis, scale = self.title or None, self.ticks(high, grid), self.scale(values)
        return kind(field, type="nominal" if self.names else "quantitative", title=title, axis=axis, scale=scale)

    def tooltip(self, field: str) -> alt.Tooltip:
        """Return what is shown when the pointer is on a point."""
        import altair as alt

        shown: Any = {} if self.names else {"format": ".1%" if self.percent else ",.4~g"}
        kind: Any = "nominal" if self.names else "quantitative"
        return alt.Tooltip(field, type=kind, title=self.title, **shown)


class Look(Protocol):
    """Something with a name and a style."""

    @property
    def label(self) -> str:
        """Its name."""

    @property
    def style(self) -> Style:
        """Its style."""


def looks(things: Sequence[Look], legend: bool = False) -> tuple[alt.Color, alt.StrokeDash, alt.Shape]:
    """Return the channels that give each thing its color, dash pattern and shape, by the field `label`."""
    import altair as alt

    names, styles = [each.label for each in things], [each.style for each in things]
    shown: Any = alt.Legend(symbolOpacity=1) if legend else None

    def scale(values: Iterable[Any]) -> alt.Scale:
        return alt.Scale(domain=names, range=list(values))

    return (
        alt.Color("label:N", title=None, legend=shown, scale=scale(each.color for each in styles)),
        alt.StrokeDash("label:N", title=None, legend=None, scale=scale(list(each.dash) for each in styles)),
        alt.Shape("label:N", title=None, legend=shown, scale=scale(each.shape for each in styles)),
    )


def chart(rows: Iterable[Mapping[str, Any]]) -> alt.Chart:
    """Return a chart without marks, with its data in it."""
    import altair as alt

    return alt.Chart(alt.InlineData(values=[dict(row) for row in rows]))


def number(value: float) -> float | None:
    """Return a value as a figure holds it: with six digits; None unless it is finite."""
    return float(f"{value:.{_DIGITS}g}") if np.isfinite(value) else None


def finite(arrays: Iterable[FloatArray | Sequence[float] | None]) -> list[float]:
    """Return the finite values of arrays, of those that are there."""
    flat = [np.ravel(np.asarray(array, dtype=np.float64)) for array in arrays if array is not None]
    joined = np.concatenate(flat) if flat else np.zeros(0)
    return [float(value) for value in joined[np.isfinite(joined)]]


def check_lengths(label: str, x: FloatArray, **others: Any) -> None:
    """Check that what belongs to the points of x has their number; None is left out.

    Raises:
        ReportError: With the label and the name.
    """
    for name, values in others.items():
        if values is not None and len(values) != len(x):
            raise ReportError(f"{label!r}: {name} has {len(values)} entries, x has {len(x)}.")


def row_size(names: Sequence[str], lines: int, width: int) -> tuple[int, int]:
    """Return width and height [px] of the area between the axes of a figure with rows.

    Args:
        names: Of the rows.
        lines: How many bars or points lie below each other in one row.
        width: Of the whole figure [px].
    """
    words = theme.text_width(max(map(len, names), default=0)) + 45
    return max(width - words, width // 3), len(names) * max(26, 19 * lines + 9)
