"""Draw curves: two points are never joined by a line, and every curve is labeled at its end."""

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
_LINE, _NAME, _BAR = 13, 24, 5
"""Height of a line of text [px]; letters of a curve's name in one line; room for a bar at the right [px]."""
_TEXT: dict[str, Any] = {"align": "left", "baseline": "middle", "fontSize": theme.FONT_SIZE, "lineHeight": _LINE}

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

    def interval(self, k: int) -> dict[str, float | None]:
        """Return the bounds at point k; nothing where there is no interval."""
        if self.lower is None or self.upper is None or not np.isfinite(self.lower[k]):
            return {}
        return {"lower": number(self.lower[k]), "upper": number(self.upper[k])}


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
    lasts = [row for row in names if row.get("lower") is not None]
    longest = max((len(word) for row in names for word in row["text"]), default=0)
    plot = max(width - 75 - theme.text_width(longest) - _BAR * len(lasts), width // 3)
    end = plot + _BAR * len(lasts)
    x_value: Any = alt.XValue
    x2_value: Any = alt.X2Value
    across, up = x.channel(alt.X, "x", xs), y.channel(alt.Y, "y", ys, grid=True)
    span = (y.channel(alt.Y, "lower", ys, grid=True), alt.Y2("upper"))
    color, dash, shape = looks([*lines, *levels])
    layers = _marker_layers(markers, across, *(x.place(each.at, xs) for each in markers))

    def add(rows: Sequence[Row], mark: str, *channels: Any, **style: Any) -> None:
        if rows:
            layers.append(getattr(chart(rows), f"mark_{mark}")(**style).encode(*channels, color))

    parts, flat = _parts(lines, x), _level_rows(levels)
    joined, dots = parts["line"], parts["mark"]
    kind = {"interpolate": "step-after" if steps else "linear"}
    tips = [alt.Tooltip("label:N", title="curve"), x.tooltip("x"), y.tooltip("y")]
    add(parts["band"], "area", across, *span, opacity=0.14, **kind)
    add([row for row in flat if row["lower"] is not None], "rect", *span, opacity=0.1)
    add(flat, "rule", up, dash, size=1.6)
    add(parts["member"], "line", across, up, alt.Detail("member:N"), size=0.9, opacity=0.6, **kind)
    add(parts["bar"], "rule", across, *span, size=1.8, opacity=0.55)
    add(joined, "line", across, up, dash, size=2, **kind)
    add(dots, "point", across, up, shape, size=55, filled=True, opacity=1)
    add([*joined, *dots], "point", across, up, tips, size=90, filled=True, opacity=0)
    for k, row in enumerate(lasts):
        add([row], "rule", x_value(plot + 4 + _BAR * k), *span, size=2.6, opacity=0.7)
    add(names, "rule", across, up, alt.Y2("at"), x2_value(end + 9), size=0.7, opacity=0.7)
    add(names, "text", x_value(end + 13), alt.Y("at:Q"), alt.Text("text:N"), **_TEXT)
    return alt.LayerChart(layer=layers, width=plot, height=theme.HEIGHT)


def _parts(lines: Sequence[Curve], x: Axis) -> dict[str, list[Row]]:
    """Return the data of lines, marks, bands, bars and thin lines ("member")."""
    parts: dict[str, list[Row]] = {name: [] for name in ("line", "mark", "band", "bar", "member")}
    for each in lines:
        known = np.flatnonzero(np.isfinite(each.y)).tolist()
        whole = len(known) >= FEWEST_JOINED
        for k in known:
            at = {"x": _place(each, k, x), "label": each.label}
            point = at | {"y": number(each.y[k])}
            parts["line"] += [point] if whole else []
            parts["mark"] += [point] if each.marked or not whole else []
            interval = each.interval(k)
            if interval and each.intervals != "last":
                parts["band" if each.intervals == "band" and whole else "bar"].append(at | interval)
            if each.members is not None and whole:
                values = [(n, number(row[k])) for n, row in enumerate(each.members)]
                parts["member"] += [at | {"y": value, "member": n} for n, value in values if value is not None]
    return parts


def _place(line: Curve, k: int, x: Axis) -> Any:
    return x.names[int(line.x[k])] if x.names else number(line.x[k])


def _level_rows(levels: Sequence[Level]) -> list[Row]:
    bounds = ("y", "lower", "upper")
    return [{"label": each.label} | {name: number(getattr(each, name)) for name in bounds} for each in levels]


def _end_names(
    lines: Sequence[Curve], levels: Sequence[Level], x: Axis, bounds: tuple[float, float], last: float
) -> list[Row]:
    """Return the names, moved apart where they would overlap, and where the thin lines to their curves begin."""
    rows: list[Row] = []
    for each in lines:
        known = np.flatnonzero(np.isfinite(each.y)).tolist()
        if known and each.named:
            k = known[-1]
            row = {"x": _place(each, k, x), "y": float(each.y[k]), "label": each.label}
            rows.append(row | each.interval(k) if each.intervals == "last" else row)
    rows += [{"x": x.names[-1] if x.names else last, "y": each.y, "label": each.label} for each in levels]
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
    """Draw vertical lines with labels on the side with space; `places` run from 0 (left) to 1 (right)."""
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
