"""Figures of curves. Two points are never joined by a line, and every curve is named at its end."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from perdure.report import theme
from perdure.report.axes import Axis, FloatArray, chart, check_lengths, finite, looks, number
from perdure.report.theme import Style

if TYPE_CHECKING:
    import altair as alt

FEWEST_JOINED = 3
"""Fewer points are not joined by a line: nothing is known between two."""
_LINE, _NAME = 13, 24
"""Height of a line of text [px]; letters of a curve's name in one line."""

Row = dict[str, Any]


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
    intervals: Literal["band", "bars", "last"] = "band"
    """How intervals are drawn: a band, a bar at each point, or one bar at the right for the last point alone."""

    def __post_init__(self) -> None:
        check_lengths(self.label, self.x, y=self.y, lower=self.lower, upper=self.upper)


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
    """An upright line with a label."""

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
    width: int = theme.WIDTH,
) -> alt.LayerChart:
    """Return a chart of curves.

    Args:
        lines: In the order in which they are drawn.
        x: Level axis.
        y: Upright axis; its title is written above it.
        markers: Upright lines, from left to right.
        levels: Level lines.
        steps: Whether a value holds until the next point.
        width: Of the whole figure [px].
    """
    import altair as alt

    ys = finite([values for each in lines for values in (each.y, each.lower, each.upper, each.members)])
    ys += finite([[each.y, each.lower, each.upper] for each in levels])
    xs = finite(each.x for each in lines)
    names = _end_names(lines, levels, x, y.bounds(ys), x.bounds(xs)[1])
    longest = max((len(word) for row in names for word in row["text"]), default=0)
    plot = max(width - 75 - theme.text_width(longest) - 5 * len(lines), width // 3)
    across, up = x.channel(alt.X, "x", xs), y.channel(alt.Y, "y", ys, grid=True)
    color, dash, shape = looks([*lines, *levels])
    interpolate = "step-after" if steps else "linear"
    x_value: Any = alt.XValue
    x2_value: Any = alt.X2Value
    joined, dots, bands, bars, members = _parts(lines, x)
    lasts = [row for row in names if row["lower"] is not None]
    shift = 5 * len(lasts)
    layers: list[alt.Chart] = []

    def add(rows: Sequence[Row], mark: str, *channels: Any, **style: Any) -> None:
        if rows:
            layers.append(getattr(chart(rows), f"mark_{mark}")(**style).encode(*channels, color))

    layers += _marker_layers(markers, across, *(x.place(each.at, xs) for each in markers))
    add(bands, "area", across, up, alt.Y2("y2"), opacity=0.14, interpolate=interpolate)
    flat = [
        {name: number(getattr(each, name)) for name in ("y", "lower", "upper")} | {"label": each.label}
        for each in levels
    ]
    spans = [row for row in flat if row["lower"] is not None]
    add(spans, "rect", y.channel(alt.Y, "lower", ys, grid=True), alt.Y2("upper"), opacity=0.1)
    add(flat, "rule", up, dash, size=1.6)
    add(members, "line", across, up, alt.Detail("member:N"), size=0.9, opacity=0.6, interpolate=interpolate)
    add(bars, "rule", across, up, alt.Y2("y2"), size=1.8, opacity=0.55)
    add(joined, "line", across, up, dash, size=2, interpolate=interpolate)
    add(dots, "point", across, up, shape, size=55, filled=True, opacity=1)
    tips = [alt.Tooltip("label:N", title="curve"), x.tooltip("x"), y.tooltip("y")]
    add([*joined, *dots], "point", across, up, tips, size=90, filled=True, opacity=0)
    for k, row in enumerate(lasts):
        place = x_value(plot + 4 + 5 * k)
        add([row], "rule", place, y.channel(alt.Y, "lower", ys, grid=True), alt.Y2("upper"), size=2.6, opacity=0.7)
    add(names, "rule", across, up, alt.Y2("at"), x2_value(plot + 9 + shift), size=0.7, opacity=0.7)
    text = {"align": "left", "baseline": "middle", "fontSize": theme.FONT_SIZE, "lineHeight": _LINE}
    add(names, "text", x_value(plot + 13 + shift), alt.Y("at:Q"), alt.Text("text:N"), **text)
    return alt.LayerChart(layer=layers, width=plot, height=theme.HEIGHT)


def _parts(lines: Sequence[Curve], x: Axis) -> tuple[list[Row], ...]:
    """Return the data of the lines, of the marks, of bands, of bars, of thin lines."""
    joined: list[Row] = []
    dots: list[Row] = []
    bands: list[Row] = []
    bars: list[Row] = []
    members: list[Row] = []
    for each in lines:
        known = np.flatnonzero(np.isfinite(each.y))
        whole = len(known) >= FEWEST_JOINED
        for k in known:
            at = {"x": x.names[int(each.x[k])] if x.names else number(each.x[k]), "label": each.label}
            point = at | {"y": number(each.y[k])}
            joined += [point] if whole else []
            dots += [point] if each.marked or not whole else []
            if (
                each.intervals != "last"
                and each.lower is not None
                and each.upper is not None
                and np.isfinite(each.lower[k])
            ):
                interval = at | {"y": number(each.lower[k]), "y2": number(each.upper[k])}
                (bands if each.intervals == "band" and whole else bars).append(interval)
            if each.members is not None and whole:
                members += [
                    at | {"y": number(row[k]), "member": n} for n, row in enumerate(each.members) if np.isfinite(row[k])
                ]
    return joined, dots, bands, bars, members


def _end_names(
    lines: Sequence[Curve], levels: Sequence[Level], x: Axis, bounds: tuple[float, float], last: float
) -> list[Row]:
    """Return the names, moved apart where they would overlap, and where the thin lines to their curves begin."""
    rows: list[Row] = []
    for each in lines:
        known = np.flatnonzero(np.isfinite(each.y))
        if len(known) and each.named:
            k = known[-1]
            at = x.names[int(each.x[k])] if x.names else number(each.x[k])
            rows.append({"x": at, "y": float(each.y[k]), "label": each.label, "lower": None, "upper": None})
            if each.intervals == "last" and each.lower is not None and each.upper is not None:
                rows[-1] |= {"lower": number(each.lower[k]), "upper": number(each.upper[k])}
    end = x.names[-1] if x.names else last
    rows += [{"x": end, "y": each.y, "label": each.label, "lower": None} for each in levels]
    for row in rows:
        unbroken = row["label"].replace(" = ", "\u00a0=\u00a0").replace(" %", "\u00a0%")
        row["text"] = textwrap.wrap(unbroken, _NAME) or [""]
    most = max((len(row["text"]) for row in rows), default=1)
    unit = (bounds[1] - bounds[0]) / theme.HEIGHT
    room = (0.5 * _LINE * most - 4) * unit  # a name of several lines stays beside the area between the axes
    wanted = np.array([row["y"] for row in rows])
    places = spread(wanted, (_LINE * most + 2) * unit, bounds[0] + room, bounds[1] - room)
    for row, place in zip(rows, places, strict=True):
        row |= {"y": number(row["y"]), "at": number(place)}
    return rows


def _marker_layers(markers: Sequence[Marker], across: alt.X, *places: float) -> list[alt.Chart]:
    """Upright lines, their labels on the side that has room; `places` are 0 at the left end and 1 at the right."""
    import altair as alt

    layers = []
    for k, (each, place) in enumerate(zip(markers, places, strict=True)):
        base = chart([{"x": number(each.at), "text": each.label}]).encode(across)
        layers.append(base.mark_rule(color=theme.SOFT, strokeDash=[2, 2]))
        left = place > 0.6 or (k == 0 and len(markers) > 1)
        where: dict[str, Any] = {"align": "right", "dx": -4} if left else {"align": "left", "dx": 4}
        text = base.mark_text(baseline="bottom", color=theme.SOFT, fontSize=theme.FONT_SIZE, **where)
        layers.append(text.encode(alt.Text("text:N"), y=alt.value(-3)))
    return layers


def spread(wanted: FloatArray, gap: float, low: float, high: float) -> FloatArray:
    """Move positions as little as possible (least squares) so that neighbors are at least `gap` apart.

    With w sorted and z_i = w_i - i * gap the answer is the isotonic regression of z [Barlow et al., 1972], shifted into
    [low, high] where there is room.

    Args:
        wanted: Shape (n,).
        gap: Least distance.
        low: Least position.
        high: Greatest position; exceeded when n labels do not fit.

    Returns:
        Positions in the order of `wanted`.
    """
    order = np.argsort(wanted, kind="stable")
    blocks: list[tuple[float, int]] = []
    for index, value in enumerate(wanted[order]):
        mean, size = float(value) - index * gap, 1
        while blocks and blocks[-1][0] > mean:
            other, count = blocks.pop()
            mean, size = (mean * size + other * count) / (size + count), size + count
        blocks.append((mean, size))
    levels = np.repeat([mean for mean, _ in blocks], [size for _, size in blocks])
    levels = np.maximum(np.minimum(levels, high - (len(wanted) - 1) * gap), low)
    placed = np.empty(len(wanted))
    placed[order] = levels + np.arange(len(wanted)) * gap
    return placed
