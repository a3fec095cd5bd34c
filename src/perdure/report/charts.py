"""Charts as plain functions, and figures: a chart with title and note, as PNG, SVG, PDF or a specification in a page.

`curve_chart` draws curves, `point_chart` points with intervals in rows, `bar_chart` bars with texts in rows. They take
numbers, know nothing of tables, and return Vega-Lite specifications with their data: page and files show the same.

Colors follow Okabe and Ito, "Color Universal Design" (2008); the scale for ordered values follows viridis (Smith and
van der Walt, 2015), cut where it would vanish into the background. A color never stands alone: a dash pattern, a shape
or a name at the curve says the same again, for readers who see no color and for print.
"""

from __future__ import annotations

import json
import math
import re
import struct
import textwrap
import zlib
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from perdure.errors import PerdureError
from perdure.runs import write_atomic
from perdure.stats import FloatArray

# Style

WIDTH = 660
"""Of a half-page figure [px]."""
WIDE = 1120
"""Width of a full-page figure [px]."""
HEIGHT = 290
"""Of the area between the axes [px]."""
PNG_SCALE = 2.0
"""Pixels of a PNG for each of these."""
FONT_SIZE = 14
"""Of all text but the title: that of a page's notes and tables [px]."""
TITLE_SIZE = 17
LETTER = 0.52
"""Mean width of a letter in font sizes."""

PAPER = "#ffffff"
INK = "#2b2f36"
SOFT = "#5f656e"
GRID = "#e4e6ea"
FADED = "#8b9099"
_CATEGORIES = {
    "#0072b2": "#56a8e0",
    "#d55e00": "#ff8a4c",
    "#009e73": "#2fc79a",
    "#b4568d": "#e79cc4",
    "#b07900": "#f5bd41",
    "#3b93cc": "#9ad7ff",
    "#6b4fa0": "#b79ae0",
    "#6e6e6e": "#bdbdbd",
}
_VIRIDIS = ("#440154", "#46327e", "#365c8d", "#277f8e", "#1fa187", "#4ac16d", "#86c93a")
_VIRIDIS_DARK = ("#5b7fc7", "#3f9fb8", "#26b39a", "#44c878", "#86d95a", "#c3e34a", "#fdec5c")


def _shades(anchors: Sequence[str], count: int = 25) -> list[str]:
    """Return so many colors between the anchors."""
    channels = np.array([list(bytes.fromhex(anchor[1:])) for anchor in anchors])
    places = np.linspace(0, len(anchors) - 1, count)
    blended = [np.interp(places, range(len(anchors)), channel) for channel in channels.T]
    return ["#" + bytes(np.rint(color).astype(int).tolist()).hex() for color in np.transpose(blended)]


_SCALE = dict(zip(_shades(_VIRIDIS), _shades(_VIRIDIS_DARK), strict=True))
DARK = {
    **{PAPER: "#1c1f23", INK: "#e6e8eb", SOFT: "#a3a9b2", GRID: "#33373d", FADED: "#8b9099"},
    **_CATEGORIES,
    **_SCALE,
}
"""Every color of a figure, and what a dark page draws instead."""
SOLID = (1, 0)
_DASHES = (SOLID, (6, 3), (2, 2), (8, 3, 2, 3), (12, 3), (4, 2, 1, 2), (3, 4), (1, 3))
_SHAPES = ("circle", "square", "triangle-up", "diamond", "cross", "triangle-down", "triangle-right", "triangle-left")

_WORDS: dict[str, Any] = {
    **{"labelFontSize": FONT_SIZE, "titleFontSize": FONT_SIZE, "labelColor": INK, "titleColor": SOFT},
    **{"titleFontWeight": "normal", "labelLimit": 0, "titleLimit": 0},
}
CONFIG: dict[str, Any] = {
    "background": PAPER,
    "font": "Helvetica, Arial, sans-serif",
    "padding": 12,
    "view": {"stroke": None},
    "title": {
        **{"anchor": "start", "frame": "bounds", "color": INK, "fontSize": TITLE_SIZE, "limit": 0, "offset": 12},
        **{"subtitleColor": SOFT, "subtitleFontSize": FONT_SIZE, "subtitleLineHeight": 19, "subtitlePadding": 6},
    },
    "axis": {
        **_WORDS,
        "gridColor": GRID,
        "domainColor": SOFT,
        "ticks": False,
        "labelPadding": 8,
        "titlePadding": 8,
        "labelSeparation": 8,
    },
    # The title of the upright axis lies level above it, where it can be read.
    "axisY": {
        **{"titleAngle": 0, "titleAlign": "left", "titleBaseline": "bottom", "titleX": 0, "titleY": -30},
        "domain": False,
    },
    "legend": {**_WORDS, "orient": "top", "title": None, "symbolSize": 70, "columnPadding": 18, "offset": 10},
}
"""Configuration of every Vega-Lite specification."""


@dataclass(frozen=True)
class Style:
    """Color, dash pattern and shape of one item."""

    color: str
    """One of `DARK`."""
    dash: tuple[int, ...] = SOLID
    """Lengths of dashes and gaps [px]."""
    shape: str = "circle"


def style(index: int) -> Style:
    """Return the style of the `index`-th unordered thing; they repeat after eight."""
    place = index % len(_CATEGORIES)
    return Style(list(_CATEGORIES)[place], _DASHES[place], _SHAPES[place])


def ordered_style(position: float) -> Style:
    """Return the style of an ordered thing, 0 for the least and 1 for the greatest: one of 25 shades."""
    colors = list(_SCALE)
    return Style(colors[round(min(max(position, 0.0), 1.0) * (len(colors) - 1))])


def text_width(letters: int, size: float = FONT_SIZE) -> int:
    """Return about how wide a text is, in px."""
    return round(LETTER * size * letters)


# Axes and data

SCHEMA = "https://vega.github.io/schema/vega-lite/v6.json"
Spec = dict[str, Any]
"""A Vega-Lite specification, or a part of one."""
Row = dict[str, Any]


@dataclass(frozen=True)
class Axis:
    """Quantity and range of one axis."""

    title: str
    """In words, with the unit and n."""
    log: bool = False
    percent: bool = False
    """The values are shares, written in percent; the axis goes from 0 to 1."""
    low: float | None = None
    """Where the axis begins, or before where values do; None: as the values want."""
    high: float | None = None
    """Where it ends, or behind where values do."""
    names: tuple[str, ...] = ()
    """Names of the places 0, 1, 2, ...: a list, not a scale."""

    def bounds(self, values: Sequence[float]) -> tuple[float, float]:
        """Return the ends of the axis, all values between them; 0 too unless it is logarithmic or has its own ends."""
        if self.percent:
            return 0.0, 1.0
        least = min(values, default=0.0)
        most = max(values, default=1.0)
        low = least
        high = most
        if not self.log:
            low = min(least, 0.0)
            high = max(most, 0.0)
            margin = 0.04 * (high - low or 1.0)
            if low < 0.0:
                low -= margin
            high += margin
        if self.low is not None:
            low = min(self.low, least)
        if self.high is not None:
            high = max(self.high, most)
        if high <= low:
            high = low + 1.0
        return low, high

    def ticks(self, high: float, grid: bool, values: Sequence[float] = ()) -> Spec:
        """Return the marks of an axis whose values reach `high`; at `values` where they are given."""
        marks: Spec = {"grid": grid, "labelFlush": False, "tickCount": 6}
        if self.names:
            # One word a line: side by side, whole names would overlap on a narrow page.
            marks |= {"labelAngle": 0, "labelOverlap": False, "labelExpr": "split(datum.label, ' ')"}
        elif self.percent:
            values = values or (0.0, 0.2, 0.4, 0.6, 0.8, 1.0)
            marks |= {"labelExpr": "format(100 * datum.value, '~g') + ' %'"}
        elif self.log:
            low = self.low or high / 1e3
            first = math.ceil(math.log10(low) - 1e-9)
            last = math.floor(math.log10(high) + 1e-9)
            powers = [10.0**k for k in range(first, last + 1)]
            if powers and high >= 2.0 * powers[-1]:
                powers.append(high)
            values = powers
            marks["format"] = ",.0f" if low >= 1.0 else "~g"
        elif high >= 10_000.0:
            marks |= {"labelExpr": "format(datum.value, '~s')"}
        if values:
            marks["values"] = list(values)
        return marks

    def channel(self, field: str, values: Sequence[float], grid: bool = False) -> Spec:
        """Return a position channel with room for `values`."""
        low, high = self.bounds(values)
        if self.names:
            kind = "nominal"
            scale: Spec = {"domain": list(self.names)}
        else:
            kind = "quantitative"
            scale = {"type": "log" if self.log else "linear", "domain": [low, high], "nice": False}
        return {
            **{"field": field, "type": kind, "title": self.title or None},
            **{"axis": self.ticks(high, grid), "scale": scale},
        }

    def tooltip(self, field: str) -> Spec:
        """Return what is shown when the pointer is on a point."""
        shown = {"field": field, "title": self.title, "type": "nominal"}
        if not self.names:
            shown["type"] = "quantitative"
            shown["format"] = ".1%" if self.percent else ",.4~g"
        return shown


def named(field: str, **more: Any) -> Spec:
    """Return a channel of names."""
    return {"field": field, "type": "nominal", **more}


def _looks(things: Sequence[Any], legend: bool = False) -> tuple[Spec, Spec, Spec]:
    """Return the channels that give each thing its color, dash pattern and shape, by the field `label`."""
    shown = {"symbolOpacity": 1} if legend else None
    labels = [each.label for each in things]
    colors = [each.style.color for each in things]
    shapes = [each.style.shape for each in things]
    dashes = [[*each.style.dash] for each in things]
    return (
        named("label", title=None, legend=shown, scale={"domain": labels, "range": colors}),
        named("label", title=None, legend=None, scale={"domain": labels, "range": dashes}),
        named("label", title=None, legend=shown, scale={"domain": labels, "range": shapes}),
    )


def layer(rows: Iterable[Row], mark: str, style: Spec, **channels: Any) -> Spec:
    """Return marks of one kind with their data."""
    return {"data": {"values": list(rows)}, "mark": {"type": mark, **style}, "encoding": channels}


def number(value: float) -> float | None:
    """Return a value as a figure holds it: with six digits; None unless it is finite."""
    if not np.isfinite(value):
        return None
    return float(f"{value:.6g}")


def _finite(arrays: Iterable[FloatArray | Sequence[float] | None]) -> list[float]:
    """Return the finite values of arrays, of those that are there."""
    joined = np.concatenate([np.zeros(0), *(np.ravel(array) for array in arrays if array is not None)])
    return [float(value) for value in joined[np.isfinite(joined)]]


# Curves

FEWEST_JOINED = 3
"""Fewer points are not joined by a line: nothing is known between two."""
_LINE = 17
"""Height of a line of text [px]."""
_NAME = 20
"""Letters of a curve's name in one line."""
_ROW_NAME = 26
"""Letters of a row's name in one line."""
_BAR = 12
"""Room for an interval at the right [px]."""
_CAP = 8
"""Width of the ends of an interval at the right [px]."""
_AT_RISK = 64
"""From the axis down to the numbers at risk [px]."""


@dataclass(frozen=True)
class Curve:
    """Points in order of x, each perhaps within an interval."""

    label: str
    """Written at its end; no other curve of the figure has it."""
    x: FloatArray
    """Shape (points,)."""
    y: FloatArray
    style: Style
    lower: FloatArray | None = None
    """Lower bounds, shape (points,); nan: no interval there."""
    upper: FloatArray | None = None
    members: FloatArray | None = None
    """Thin lines of what the curve is the mean of, shape (members, points)."""
    marked: bool = False
    """Whether every point has a mark."""
    named: bool = True
    """Whether its label is written."""
    joined: bool = True
    """Whether a line joins the points, where there are enough."""
    intervals: Literal["band", "bars", "last"] = "band"
    """How intervals are drawn: a band, a bar at each point, or one bar at the right for the last point alone."""
    watched: FloatArray | None = None
    """Until which x each of its episodes is watched; how many still are is written under the axis."""

    def _points(self, x: Axis) -> list[tuple[int, Row, Row]]:
        """Return index, place and interval ({}: none) of every known point."""
        found = []
        for k in np.flatnonzero(np.isfinite(self.y)).tolist():
            at: Row = {"x": number(self.x[k]), "label": self.label}
            if x.names:
                at["x"] = x.names[int(self.x[k])]
            interval: Row = {}
            if self.lower is not None and self.upper is not None and np.isfinite(self.lower[k]):
                interval = {"lower": number(self.lower[k]), "upper": number(self.upper[k])}
            found.append((k, at, interval))
        return found


@dataclass(frozen=True)
class Level:
    """A level line over the whole width: a value that does not depend on x."""

    label: str
    y: float
    lower: float
    """Of its interval; nan: none."""
    upper: float
    style: Style


@dataclass(frozen=True)
class Marker:
    """A vertical line with a label."""

    at: float
    label: str


def curve_chart(
    lines: Sequence[Curve],
    x: Axis,
    y: Axis,
    *,
    markers: Sequence[Marker] = (),
    levels: Sequence[Level] = (),
    steps: bool = False,
    width: int = WIDTH,
) -> Spec:
    """Return a chart of curves: two points are never joined by a line, and every curve is labeled at its end.

    With `steps` a value holds until the next point. `width` is that of the whole figure [px].
    """
    # What the axes have to hold.
    ys = []
    for each in lines:
        ys += _finite([each.y, each.lower, each.upper, each.members])
    ys += _finite([[each.y, each.lower, each.upper] for each in levels])
    xs = _finite(each.x for each in lines)
    across = x.channel("x", xs)
    up = y.channel("y", ys, grid=True)
    # Room at the right for names, and for the intervals of the last points.
    names = _end_names(lines, levels, x, y.bounds(ys), x.bounds(xs)[1])
    lasts = [row for row in names if row.get("lower") is not None]
    longest = max((len(word) for row in names for word in row["text"]), default=0)
    bars_end = _BAR * len(lasts) + (8 if lasts else 0)
    plot = max(width - 85 - text_width(longest) - bars_end, width // 3)
    # Data and channels of the layers.
    span = {"y": up | {"field": "lower"}, "y2": {"field": "upper"}}
    color, dash, shape = _looks([*lines, *levels])
    joined, dots, bands, bars, members = _curve_rows(lines, x)
    flat = [
        {"label": each.label, "y": number(each.y), "lower": number(each.lower), "upper": number(each.upper)}
        for each in levels
    ]
    kind = {"interpolate": "step-after" if steps else "linear"}
    tips = [named("label", title="curve"), x.tooltip("x"), y.tooltip("y")]
    edge = {"value": "width"}  # a page may change the width
    point = {"x": across, "y": up, "color": color}
    level_bands = [row for row in flat if row["lower"] is not None]
    words = {"align": "left", "baseline": "middle", "fontSize": FONT_SIZE, "lineHeight": _LINE, "dx": bars_end + 13}
    words["dy"] = {"expr": f"{-_LINE / 2} * (length(datum.text) - 1)"}  # Vega places the first line, not the middle
    text = named("text")
    layers = [
        *_marker_layers(markers, across, x, xs),
        layer(bands, "area", {"opacity": 0.14, **kind}, x=across, **span, color=color),
        layer(level_bands, "rect", {"opacity": 0.1}, **span, color=color),
        layer(flat, "rule", {"size": 1.6}, y=up, strokeDash=dash, color=color),
        layer(members, "line", {"size": 0.9, "opacity": 0.6, **kind}, **point, detail=named("member")),
        layer(bars, "rule", {"size": 1.8, "opacity": 0.55}, x=across, **span, color=color),
        layer(joined, "line", {"size": 2, **kind}, **point, strokeDash=dash),
        layer(dots, "point", {"size": 55, "filled": True, "opacity": 1}, **point, shape=shape),
        layer([*joined, *dots], "point", {"size": 90, "filled": True, "opacity": 0}, **point, tooltip=tips),
    ]
    # The interval of the last point stands apart from the curve and has ends, so that nobody takes it for a drop.
    for k, row in enumerate(lasts):
        offset = 0.5 * _CAP + 8 + _BAR * k
        bar = {"size": 1.6, "xOffset": offset}
        layers.append(layer([row], "rule", bar, x=edge, **span, color=color, strokeDash=dash))
        cap = {"width": _CAP, "height": 1.6, "xOffset": offset}
        for end in ("lower", "upper"):
            layers.append(layer([row], "rect", cap, x=edge, y=up | {"field": end}, color=color))
        layers.append(layer([row], "point", {"size": 30, "filled": True, "xOffset": offset}, x=edge, y=up, color=color))
    thin = {"size": 0.7, "opacity": 0.7, "x2Offset": bars_end + 9}
    layers.append(layer(names, "rule", thin, **point, y2={"field": "at"}, x2=edge))
    layers.append(
        layer(names, "text", words, x=edge, y={"field": "at", "type": "quantitative"}, text=text, color=color)
    )
    layers += _at_risk_layers([each for each in lines if each.watched is not None], across, bars_end, color)
    return {"layer": [each for each in layers if each["data"]["values"]], "width": plot, "height": HEIGHT}


def _curve_rows(lines: Sequence[Curve], x: Axis) -> tuple[list[Row], ...]:
    """Return the data of lines, marks, bands, bars and thin lines."""
    joined: list[Row] = []
    dots: list[Row] = []
    bands: list[Row] = []
    bars: list[Row] = []
    members: list[Row] = []
    for each in lines:
        points = each._points(x)
        whole = each.joined and len(points) >= FEWEST_JOINED
        for k, at, interval in points:
            # A mark where no line shows the point.
            point = at | {"y": number(each.y[k])}
            if whole:
                joined.append(point)
            if each.marked or not whole:
                dots.append(point)
            # Its interval, and what it is the mean of.
            if interval and each.intervals == "band" and whole:
                bands.append(at | interval)
            elif interval and each.intervals != "last":
                bars.append(at | interval)
            if each.members is not None and whole:
                values = [(n, number(row[k])) for n, row in enumerate(each.members)]
                members += [at | {"y": value, "member": n} for n, value in values if value is not None]
    return joined, dots, bands, bars, members


def _end_names(
    lines: Sequence[Curve], levels: Sequence[Level], x: Axis, bounds: tuple[float, float], last: float
) -> list[Row]:
    """Return the names, moved apart where they would overlap, and where the thin lines to their curves begin."""
    rows: list[Row] = []
    for each in lines:
        points = each._points(x)
        if each.named and points:
            k, at, interval = points[-1]
            end = at | {"y": float(each.y[k])}
            if each.intervals == "last":
                end |= interval
            rows.append(end)
    right = x.names[-1] if x.names else last
    rows += [{"x": right, "y": each.y, "label": each.label} for each in levels]
    for row in rows:
        row["text"] = _wrapped(row["label"])
    most = max((len(row["text"]) for row in rows), default=1)
    unit = (bounds[1] - bounds[0]) / HEIGHT
    room = (0.5 * _LINE * most - 4) * unit  # a name of several lines stays beside the area between the axes
    wanted = np.array([row["y"] for row in rows])
    places = spread(wanted, (_LINE * most + 2) * unit, bounds[0] + room, bounds[1] - room)
    for row, place in zip(rows, places, strict=True):
        row |= {"y": number(row["y"]), "at": number(place)}
    return rows


def _wrapped(label: str) -> list[str]:
    """Return the lines of a name at the right."""
    return textwrap.wrap(label.replace(" = ", "\u00a0=\u00a0").replace(" %", "\u00a0%"), _NAME) or [""]


def _at_risk_layers(curves: Sequence[Curve], across: Spec, right: float, color: Spec) -> Iterator[Spec]:
    """Write under the marks of the axis how many episodes of each curve are still watched."""
    place = HEIGHT + _AT_RISK
    ticks = across["axis"].get("values", ())
    if not curves or not ticks:
        return
    style = {"baseline": "middle", "fontSize": FONT_SIZE, "lineHeight": _LINE}
    heading = [{"text": "number at risk"}]
    soft = {**style, "align": "left", "color": SOFT}
    # Where a page is narrow, a number that would touch the one before it is left out, as the axis does with its labels.
    before = [None, *ticks[:-1]]
    longest = max(len(f"{np.asarray(each.watched).size:,}") for each in curves)
    space = f"scale('x', datum.x) - scale('x', datum.before) > {text_width(longest) + 4}"
    counts = {**style, "opacity": {"expr": f"datum.before == null || {space} ? 1 : 0"}}
    yield layer(heading, "text", soft, x={"value": 0}, y={"value": place}, text=named("text"))
    for each in curves:
        place += _LINE + 3
        y = {"value": place}
        watched = np.asarray(each.watched)
        rows = [
            {"x": at, "before": last, "label": each.label, "text": f"{(watched >= at).sum():,}"}
            for at, last in zip(ticks, before, strict=True)
        ]
        yield layer(rows, "text", counts, x=across, y=y, text=named("text"), color=color)
        if len(curves) > 1:
            name = [{"label": each.label, "text": _wrapped(each.label)}]
            beside = {**style, "align": "left", "baseline": "line-top", "dx": right + 13, "dy": -0.5 * _LINE}
            yield layer(name, "text", beside, x={"value": "width"}, y=y, text=named("text"), color=color)
            place += _LINE * (len(name[0]["text"]) - 1)


def _marker_layers(markers: Sequence[Marker], across: Spec, x: Axis, xs: Sequence[float]) -> Iterator[Spec]:
    """Draw vertical lines with labels on the side with space."""
    for k, each in enumerate(markers):
        ends = np.array([*x.bounds(xs), each.at])
        if x.log:
            ends = np.log(ends)
        low, high, at = ends
        left = (at - low) / (high - low) > 0.6 or (k == 0 and len(markers) > 1)
        rows = [{"x": number(each.at), "text": each.label}]
        yield layer(rows, "rule", {"color": SOFT, "strokeDash": [2, 2]}, x=across)
        style: Spec = {"align": "left", "dx": 4}
        if left:
            style = {"align": "right", "dx": -4}
        style |= {"baseline": "bottom", "color": SOFT, "fontSize": FONT_SIZE}
        yield layer(rows, "text", style, x=across, y={"value": -9}, text=named("text"))


def spread(wanted: FloatArray, gap: float, low: float, high: float) -> FloatArray:
    """Move positions as little as possible (least squares) so that neighbors are at least `gap` apart.

    With w sorted and z_i = w_i - i * gap the answer is the isotonic regression of z [Barlow et al., 1972], shifted into
    [low, high] where there is room: with too many positions, `high` is exceeded. The order stays that of `wanted`.
    """
    from scipy.optimize import isotonic_regression

    if not len(wanted):
        return wanted
    order = np.argsort(wanted, kind="stable")
    gaps = np.arange(len(wanted)) * gap
    placed = np.empty(len(wanted))
    placed[order] = np.maximum(np.minimum(isotonic_regression(wanted[order] - gaps).x, high - gaps[-1]), low) + gaps
    return placed


# Rows of points or bars


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


def point_chart(names: Sequence[str], points: Sequence[Points], x: Axis, width: int = WIDTH) -> Spec:
    """Return a chart of points in rows with these names, with a legend where there is more than one kind.

    Kinds are drawn below each other in every row. `width` is that of the whole figure [px].
    """
    names = _row_names(names)
    color, _, shape = _looks(points, legend=len(points) > 1)
    row_of = _row_channels(names, points)
    rows: list[Row] = []
    rings: list[Row] = []
    values: list[float] = []
    for each in points:
        values += _finite([each.x, each.lower, each.upper])
        for k, row in enumerate(each.rows):
            at = {"label": each.label, "row": names[row]}
            point = at | {"x": number(each.x[k]), "low": None, "high": None}
            if each.lower is not None:
                point["low"] = number(each.lower[k])
            if each.upper is not None:
                point["high"] = number(each.upper[k])
            rows.append(point)
            if each.members:
                rings += [at | {"x": number(value)} for value in each.members[k]]
    values += [ring["x"] for ring in rings]
    across = x.channel("x", values, grid=True)
    tips = [named("row", title="row"), named("label", title="kind"), x.tooltip("x")]
    tips += [
        {"field": bound, "type": "quantitative", "title": f"{bound} end of the interval"} for bound in ("low", "high")
    ]
    ranges = [row for row in rows if row["low"] is not None]
    dots = [row for row in rows if row["x"] is not None]
    span = {"x": across | {"field": "low"}, "x2": {"field": "high"}}
    looks = {"x": across, "color": color, "shape": shape}
    ring = {"size": 30, "filled": False, "strokeWidth": 1.3}
    layers = [
        layer(ranges, "rule", {"size": 2.4, "opacity": 0.5}, **row_of, **span, color=color),
        layer(rings, "point", {**ring, "opacity": 1}, **row_of, **looks),
        layer(dots, "point", {"size": 75, "filled": True, "opacity": 1}, **row_of, **looks, tooltip=tips),
    ]
    plot, height = row_size(names, len(points), width)
    return {"layer": layers, "width": plot, "height": height}


def bar_chart(names: Sequence[str], bars: Sequence[Bars], x: Axis, width: int = WIDTH) -> Spec:
    """Return a chart of bars in rows with these names. Where a row has several, each text begins with its bar's label.

    The axis begins at 0; room for the texts is added. `width` is that of the whole figure [px].
    """
    names = _row_names(names)
    color, _, _ = _looks(bars)
    row_of = _row_channels(names, bars, line=True)
    rows: list[Row] = []
    for each in bars:
        for k, row in enumerate(each.rows):
            text = each.texts[k]
            if len(bars) > 1:
                text = f"{each.label}: {text}"
            end = each.x[k]
            if each.whole is not None:
                end = each.whole[k]
            at = {"label": each.label, "row": names[row]}
            rows.append(at | {"x": number(each.x[k]), "end": number(end), "text": text})
    plot, height = row_size(names, len(bars), width)
    most = max((row["end"] for row in rows), default=0.0) or 1.0
    # So long that every text finds room behind its bar.
    room = [(plot - 14 - text_width(len(row["text"])), row["end"]) for row in rows if row["end"]]
    unit = max(min((pixels / end for pixels, end in room), default=plot / most), plot / most / 4)
    axis = x.ticks(most, grid=False, values=_round_ticks(most, 0.0 if x.percent else 1.0))
    across = {
        **{"type": "quantitative", "title": x.title, "axis": axis | {"domain": False, "titleAnchor": "start"}},
        "scale": {"domain": [0.0, plot / unit], "nice": False},
    }
    behind = across | {"field": "end"}
    layers: list[Spec] = []
    if any(each.whole is not None for each in bars):
        layers.append(layer(rows, "bar", {"opacity": 0.3}, **row_of, x=behind, color=color))
    layers.append(layer(rows, "bar", {}, **row_of, x=across | {"field": "x"}, color=color))
    style = {"align": "left", "baseline": "middle", "dx": 4, "fontSize": FONT_SIZE, "color": INK}
    layers.append(layer(rows, "text", style, **row_of, x=behind, text=named("text")))
    return {"layer": layers, "width": plot, "height": height}


def row_size(names: Sequence[str], lines: int, width: int) -> tuple[int, int]:
    """Return width and height [px] of the area between the axes of a figure with rows of so many lines each."""
    lines_of = [name.split("\n") for name in names]
    words = text_width(max((len(line) for each in lines_of for line in each), default=0)) + 50
    tallest = max(map(len, lines_of), default=1)
    return max(width - words, width // 3), len(names) * max(30, 22 * lines + 9, _LINE * tallest + 8)


def _row_names(names: Sequence[str]) -> list[str]:
    """Return the names of rows, long ones in several lines."""
    wrapped = []
    for name in names:
        kept = name.replace(" = ", "\u00a0=\u00a0")
        wrapped.append(name if len(name) <= _ROW_NAME else textwrap.fill(kept, _ROW_NAME))
    return wrapped


def _row_channels(names: Sequence[str], things: Sequence[Any], line: bool = False) -> Spec:
    scale = {"domain": list(names), "paddingInner": 0.3, "paddingOuter": 0.1}
    axis: Spec = {"labelPadding": 10, "domain": line}
    if any("\n" in name for name in names):
        axis |= {"labelExpr": "split(datum.label, '\\n')", "labelLineHeight": _LINE}
    offset = {"domain": [each.label for each in things], "paddingInner": 0.12}
    return {
        "y": named("row", title=None, scale=scale, axis=axis),
        "yOffset": named("label", scale=offset),
    }


def _round_ticks(most: float, least_step: float) -> list[float]:
    """Return 0 and the multiples of 1, 2 or 5 times a power of ten up to `most`, six at most."""
    power = 10.0 ** math.floor(math.log10(most / 5.0))
    step = max(next(power * k for k in (1, 2, 5, 10) if power * k * 5.0 >= most * (1.0 - 1e-9)), least_step)
    return [float(f"{k * step:.6g}") for k in range(math.floor(most / step + 1e-9) + 1)]


# Figures

Format = Literal["png", "svg", "pdf"]
FORMATS: tuple[Format, ...] = get_args(Format)


@dataclass(frozen=True)
class Figure:
    """A chart with its title and note."""

    name: str
    """For files and anchors: lower-case letters and digits, dashes between them, see `slug`."""
    title: str
    """What is seen."""
    chart: Spec
    note: str = ""
    """Sentences: what intervals are, and over how many."""
    heading: str = ""
    """Such as the task: written before the title where a picture stands alone."""
    wide: bool = False
    """Whether the figure needs the whole width of a page."""

    def __post_init__(self) -> None:
        if re.fullmatch(r"[a-z0-9]+([-_][a-z0-9]+)*", self.name) is None:
            raise PerdureError(f"A figure cannot be named {self.name!r}: letters a to z, digits and dashes; see slug.")

    @cached_property
    def spec(self) -> Spec:
        """The Vega-Lite specification, without title and note; equal data of several layers stand in it once."""
        datasets: dict[str, list[Row]] = {}

        def view(part: Spec) -> Spec:
            part = part | {key: [*map(view, part[key])] for key in ("layer", "hconcat") if key in part}
            if "data" in part:
                values = part["data"]["values"]
                name = next((each for each, known in datasets.items() if known == values), f"data-{len(datasets)}")
                datasets[name] = values
                part["data"] = {"name": name}
            return part

        return {"$schema": SCHEMA, **view(self.chart), "datasets": datasets, "config": CONFIG}

    def standalone(self) -> Spec:
        """Return the specification of a picture that stands alone: heading, title and note above the chart."""
        width = WIDE if self.wide else WIDTH
        title_letters = round(width / text_width(100, TITLE_SIZE * 1.15) * 100)
        note_letters = round(width / text_width(100, FONT_SIZE) * 100)
        title = ": ".join(filter(None, (self.heading, self.title)))
        lines = {"text": textwrap.wrap(title, title_letters), "subtitle": textwrap.wrap(self.note, note_letters)}
        return {**self.spec, "title": lines}


def render(figure: Figure, kind: Format = "png") -> bytes:
    """Return a figure as the bytes of a file: "png", "svg" or "pdf"; PerdureError for another format.

    The same figure gives the same PNG and SVG, byte for byte; a PDF holds the time at which it was made.
    """
    import vl_convert

    if kind not in FORMATS:
        raise PerdureError(f"A figure cannot be written as {kind!r}; formats are {', '.join(FORMATS)}.")
    spec = figure.standalone()
    if kind == "svg":
        return str(vl_convert.vegalite_to_svg(spec, allowed_base_urls=[])).encode()
    if kind == "pdf":
        return bytes(vl_convert.vegalite_to_pdf(spec, allowed_base_urls=[]))
    return _deflate(bytes(vl_convert.vegalite_to_png(spec, scale=PNG_SCALE, allowed_base_urls=[])))


def _deflate(png: bytes) -> bytes:
    """Compress a PNG again: vl-convert's own is 2.5 times as large (measured)."""
    place = 33  # after signature and header
    head = png[:place]
    pixels = b""
    while place < len(png):
        (size,) = struct.unpack(">I", png[place : place + 4])
        if png[place + 4 : place + 8] == b"IDAT":
            pixels += png[place + 8 : place + 8 + size]
        place += 12 + size
    parts = (b"IDAT" + zlib.compress(zlib.decompress(pixels), 6), b"IEND")
    return head + b"".join(struct.pack(">I", len(p) - 4) + p + struct.pack(">I", zlib.crc32(p)) for p in parts)


def save(figures: Iterable[Figure], folder: Path, formats: Sequence[Format] = ("png",)) -> list[Path]:
    """Write figures as files named after them into a folder, and return these; PerdureError for an unknown format."""
    written = []
    for each in figures:
        written += [write_atomic(folder / f"{each.name}.{kind}", render(each, kind)) for kind in formats]
    return written


def unique(figures: Iterable[Figure], taken: set[str]) -> list[Figure]:
    """Return figures with a number behind each name that is in `taken` already; names are added to it."""
    found = []
    for figure in figures:
        name = figure.name
        copy = 2
        while name in taken:
            name = f"{figure.name}-{copy}"
            copy += 1
        taken.add(name)
        found.append(replace(figure, name=name))
    return found


@cache
def javascript() -> str:
    """Return Vega, Vega-Lite and Vega-Embed as one script that needs no network."""
    import vl_convert

    bundle: Any = vl_convert.javascript_bundle  # its stub demands a snippet, which it does not need
    return str(bundle())


def script_json(value: Any) -> str:
    """Return JSON that may stand in an HTML script element: nothing in it can end the element."""
    return json.dumps(value, allow_nan=False, separators=(",", ":"), ensure_ascii=False).replace("<", "\\u003c")


def slug(*words: str) -> str:
    """Convert words to a file name that is valid on all systems."""
    return re.sub(r"[^a-z0-9]+", "-", " ".join(words).lower()).strip("-")[:80].strip("-") or "figure"
