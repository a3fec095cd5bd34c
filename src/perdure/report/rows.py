"""Draw figures with rows: points with intervals, or bars with texts."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from perdure.report import theme
from perdure.report.axes import Axis, FloatArray, chart, check_lengths, finite, looks, number, row_size
from perdure.report.theme import Style

if TYPE_CHECKING:
    import altair as alt


@dataclass(frozen=True)
class Points:
    """One point in each of several rows, perhaps within an interval."""

    label: str
    """In the legend."""
    rows: Sequence[int]
    """In which rows, shape (points,)."""
    x: FloatArray
    style: Style
    lower: FloatArray | None = None
    """Lower bounds, shape (points,); nan: no interval there."""
    upper: FloatArray | None = None
    members: Sequence[Sequence[float]] | None = None
    """For each point the values it is the mean of, drawn as small rings."""

    def __post_init__(self) -> None:
        check_lengths(self.label, self.x, rows=self.rows, lower=self.lower, upper=self.upper, members=self.members)


@dataclass(frozen=True)
class Bars:
    """One bar in each of several rows, from 0."""

    label: str
    rows: Sequence[int]
    """In which rows, shape (bars,)."""
    x: FloatArray
    texts: Sequence[str]
    """Written behind the bars, shape (bars,)."""
    style: Style
    whole: FloatArray | None = None
    """Pale bars behind them: what x is a part of."""

    def __post_init__(self) -> None:
        check_lengths(self.label, self.x, rows=self.rows, texts=self.texts, whole=self.whole)


def point_chart(names: Sequence[str], points: Sequence[Points], x: Axis, width: int = theme.WIDTH) -> alt.LayerChart:
    """Return a chart of points in rows, with a legend where there is more than one kind.

    Args:
        names: Of the rows, from top to bottom.
        points: Drawn below each other in every row, in this order.
        x: Level axis.
        width: Of the whole figure [px].
    """
    import altair as alt

    color, _, shape = looks(points, legend=len(points) > 1)
    y, offset = _row_channels(names, [each.label for each in points])
    rows: list[dict[str, Any]] = []
    rings: list[dict[str, Any]] = []
    for each in points:
        for k, row in enumerate(each.rows):
            at = {"label": each.label, "row": names[row]}
            bounds = [np.nan if array is None else array[k] for array in (each.lower, each.upper)]
            rows.append(at | dict(zip(("x", "low", "high"), map(number, (each.x[k], *bounds)), strict=True)))
            rings += [at | {"x": number(value)} for value in (each.members[k] if each.members else ())]
    values = finite([array for each in points for array in (each.x, each.lower, each.upper)])
    values += [ring["x"] for ring in rings]
    across = x.channel(alt.X, "x", values, grid=True)
    tips = [alt.Tooltip("row:N", title="row"), alt.Tooltip("label:N", title="kind"), x.tooltip("x")]
    tips += [alt.Tooltip(f"{bound}:Q", title=f"{bound} end of the interval") for bound in ("low", "high")]
    ranges = chart(row for row in rows if row["low"] is not None).mark_rule(size=2.4, opacity=0.5)
    layers = [ranges.encode(y, offset, x.channel(alt.X, "low", values, grid=True), alt.X2("high"), color)]
    if rings:
        ring = chart(rings).mark_point(size=30, filled=False, strokeWidth=1.3, opacity=1)
        layers.append(ring.encode(y, offset, across, color, shape))
    dot = chart(row for row in rows if row["x"] is not None).mark_point(size=75, filled=True, opacity=1)
    layers.append(dot.encode(y, offset, across, color, shape, tips))
    plot, height = row_size(names, len(points), width)
    return alt.LayerChart(layer=layers, width=plot, height=height)


def bar_chart(names: Sequence[str], bars: Sequence[Bars], x: Axis, width: int = theme.WIDTH) -> alt.LayerChart:
    """Return a chart of bars in rows. Where there are several in a row, each text begins with its bar's label.

    Args:
        names: Of the rows, from top to bottom.
        bars: Drawn below each other in every row, in this order.
        x: Level axis, from 0; room for the texts is added.
        width: Of the whole figure [px].
    """
    import altair as alt

    color, _, _ = looks(bars)
    y, offset = _row_channels(names, [each.label for each in bars], line=True)
    rows: list[dict[str, Any]] = []
    for each in bars:
        for k, row in enumerate(each.rows):
            text = f"{each.label}: {each.texts[k]}" if len(bars) > 1 else each.texts[k]
            end = number(each.x[k] if each.whole is None else each.whole[k])
            rows.append({"label": each.label, "row": names[row], "x": number(each.x[k]), "end": end, "text": text})
    plot, height = row_size(names, len(bars), width)
    most = max((row["end"] for row in rows), default=0.0) or 1.0
    # So long that every text finds room behind its bar.
    room = [(plot - 14 - theme.text_width(len(row["text"])), row["end"]) for row in rows if row["end"]]
    unit = max(min((pixels / end for pixels, end in room), default=plot / most), plot / most / 4)
    scale = alt.Scale(domain=[0.0, plot / unit], nice=False)
    axis = x.ticks(most, grid=False, values=_round_ticks(most, 0.0 if x.percent else 1.0))
    axis.domain, axis.titleAnchor = False, "start"

    def across(field: str) -> alt.X:
        return alt.X(field, type="quantitative", title=x.title, axis=axis, scale=scale)

    base, layers = chart(rows), []
    if any(each.whole is not None for each in bars):
        layers.append(base.mark_bar(opacity=0.3).encode(y, offset, across("end"), color))
    layers.append(base.mark_bar().encode(y, offset, across("x"), color))
    text = base.mark_text(align="left", baseline="middle", dx=4, fontSize=theme.FONT_SIZE, color=theme.INK)
    layers.append(text.encode(y, offset, across("end"), alt.Text("text:N")))
    return alt.LayerChart(layer=layers, width=plot, height=height)


def _row_channels(names: Sequence[str], labels: Sequence[str], line: bool = False) -> tuple[alt.Y, alt.YOffset]:
    import altair as alt

    axis = alt.Axis(labelPadding=10, domain=line)
    y = alt.Y("row:N", title=None, scale=alt.Scale(domain=list(names), paddingInner=0.3, paddingOuter=0.1), axis=axis)
    return y, alt.YOffset("label:N", scale=alt.Scale(domain=list(labels), paddingInner=0.12))


def _round_ticks(most: float, least_step: float) -> list[float]:
    """Return 0 and the multiples of 1, 2 or 5 times a power of ten up to `most`, six at most."""
    power = 10.0 ** math.floor(math.log10(most / 5.0))
    step = max(next(power * k for k in (1, 2, 5, 10) if power * k * 5.0 >= most * (1.0 - 1e-9)), least_step)
    return [float(f"{k * step:.6g}") for k in range(math.floor(most / step + 1e-9) + 1)]
