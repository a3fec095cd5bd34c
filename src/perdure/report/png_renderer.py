"""A chart as PNG, drawn by matplotlib's Agg."""

from __future__ import annotations

import io
import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from perdure.report import wording
from perdure.report.charts import Axis, Bars, Chart, FloatArray, Series
from perdure.report.palette import INK

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_DPI = 160
_WIDTH, _HEIGHT = 8.4, 4.7
_ROW, _LINE = 0.27, 0.19
_LEGEND_COLUMNS, _LEGEND_LINE = 5, 0.21
_NOTE_LETTERS, _NOTE_LINE = 128, 0.155
_TEXT, _GREY, _GRID = INK.light, "#6b7079", "#e4e6ea"
_DASHES = {"solid": "-", "dash": (0, (5, 2.2)), "dot": (0, (1.2, 1.6)), "dashdot": (0, (5, 1.8, 1.2, 1.8))}
_STYLE: Any = {"font.family": "DejaVu Sans", "font.size": 9.5, "text.color": _TEXT, "text.parse_math": False}


def render_png(chart: Chart, heading: str = "") -> bytes:
    """Draw a chart.

    Args:
        chart: What to draw.
        heading: Written before the chart's title, such as the task.

    Returns:
        The bytes of a PNG file, on white; the same chart gives the same bytes.
    """
    import matplotlib
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    with matplotlib.rc_context(_STYLE):
        figure = Figure(figsize=(_WIDTH, _figure_height(chart)), dpi=_DPI, facecolor="white")
        FigureCanvasAgg(figure)
        axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
        _draw_axes(axes, chart)
        for bars in chart.bars:
            _draw_bars(axes, bars)
        for order, series in enumerate(chart.series):
            _draw_series(axes, series, rows=bool(chart.y.rows), order=order)
        _place(figure, axes, chart)
        _draw_markers(axes, chart)
        for bars in chart.bars:
            _draw_bar_texts(figure, axes, bars)
        if chart.y.rows:
            _draw_row_legend(axes, chart)
        else:
            _draw_tags(axes, chart.series)
        _draw_texts(figure, axes, chart, heading)
        buffer = io.BytesIO()
        figure.savefig(buffer, format="png", metadata={"Software": None})
    return buffer.getvalue()


def _figure_height(chart: Chart) -> float:
    if not chart.y.rows:
        return _HEIGHT + _note_room(chart)
    row = max(_ROW, _LINE * chart.row_lines + 0.1)
    return 1.75 + row * len(chart.y.rows) + _LEGEND_LINE * (_legend_lines(chart) - 1) + _note_room(chart)


def _note_room(chart: Chart) -> float:
    """Inches that a note of more than one line takes."""
    return _NOTE_LINE * max(0, len(_note_lines(chart)) - 1)


def _note_lines(chart: Chart) -> list[str]:
    return textwrap.wrap(chart.note, _NOTE_LETTERS)


def _legend_lines(chart: Chart) -> int:
    return -(-len(_legend_labels(chart)) // _LEGEND_COLUMNS)


def _legend_labels(chart: Chart) -> list[str]:
    return [bars.label for bars in chart.bars if bars.label] + [series.label for series in chart.series]


def _draw_axes(axes: Axes, chart: Chart) -> None:
    for side in ("top", "right", "left"):
        axes.spines[side].set_visible(False)
    axes.spines["bottom"].set_color(_GREY)
    axes.grid(axis="x" if chart.y.rows else "y", color=_GRID, linewidth=0.8)
    axes.set_axisbelow(True)
    axes.tick_params(axis="both", colors=_GREY, labelcolor=_TEXT, length=0, pad=5)
    _scale_axis(axes, "x", chart.x)
    if chart.y.rows:
        axes.set_yticks(range(len(chart.y.rows)), labels=list(chart.y.rows))
        axes.set_ylim(len(chart.y.rows) - 0.4, -0.6)
    else:
        _scale_axis(axes, "y", chart.y)
    axes.set_xlabel(chart.x.title, color=_GREY, labelpad=6)


def _scale_axis(axes: Axes, name: str, axis: Axis) -> None:
    from matplotlib.ticker import FuncFormatter, NullFormatter, NullLocator

    target = axes.xaxis if name == "x" else axes.yaxis
    if axis.rows:
        target.set_ticks(range(len(axis.rows)), labels=list(axis.rows))
        axes.set_xlim(-0.3, len(axis.rows) - 0.7)
        return
    if axis.log:
        (axes.set_xscale if name == "x" else axes.set_yscale)("log")
        target.set_minor_formatter(NullFormatter())
        target.set_minor_locator(NullLocator())
    limits = axes.set_xlim if name == "x" else axes.set_ylim
    margin = 0.02 if axis.percent else 0.0
    if axis.low is not None or axis.high is not None:  # naming no limit would stop matplotlib from finding them
        limits(
            None if axis.low is None else axis.low - margin,
            None if axis.high is None else axis.high + margin,
        )
    if axis.ticks is not None:
        target.set_ticks(axis.ticks)
    target.set_major_formatter(
        FuncFormatter(lambda value, _: f"{round(100 * value, 6):g} %" if axis.percent else wording.short(value))
    )


def _draw_bars(axes: Axes, bars: Bars) -> None:
    alpha = 0.3 if bars.pale else 1.0
    lengths = bars.end - bars.start
    axes.barh(bars.rows, lengths, bars.thickness, bars.start, color=bars.colour.light, alpha=alpha, linewidth=0)


def _draw_bar_texts(figure: Figure, axes: Axes, bars: Bars) -> None:
    """Texts after the bars, or in those with room for them. Drawn when the axes have their place."""
    renderer = figure.canvas.get_renderer()  # type: ignore[attr-defined]
    for row, start, end, text in zip(bars.rows, bars.start, bars.end, bars.texts, strict=False):
        if not bars.inside:
            axes.annotate(
                text, (end, row), xytext=(4, 0), textcoords="offset points", color=_TEXT, fontsize=8.5, va="center"
            )
            continue
        drawn = axes.text(0.5 * (start + end), row, text, color="white", fontsize=8.5, ha="center", va="center")
        left, right = (float(axes.transData.transform((x, row))[0]) for x in (start, end))
        if drawn.get_window_extent(renderer).width + 6 > right - left:
            drawn.remove()


def _draw_series(axes: Axes, series: Series, rows: bool, order: int) -> None:
    colour = series.colour.light
    if series.lower is not None and series.upper is not None:
        if rows:
            axes.hlines(series.y, series.lower, series.upper, color=colour, linewidth=2.2, alpha=0.45, zorder=3 + order)
        elif series.points:
            axes.vlines(series.x, series.lower, series.upper, color=colour, linewidth=1.6, alpha=0.55, zorder=3)
        else:
            axes.fill_between(series.x, series.lower, series.upper, color=colour, alpha=0.13, linewidth=0, zorder=2)
    axes.plot(
        series.x,
        series.y,
        color=colour,
        linestyle=_DASHES[series.dash] if series.line else "none",
        linewidth=1.9,
        marker="o" if series.points else "none",
        markersize=6.0,
        markerfacecolor="white" if series.hollow else colour,
        markeredgewidth=1.6,
        solid_capstyle="round",
        zorder=4 + order,
    )


def _place(figure: Figure, axes: Axes, chart: Chart) -> None:
    """Give the axes the room that tick labels at the left and tags at the right leave."""
    width, height = figure.get_size_inches()
    renderer = figure.canvas.get_renderer()  # type: ignore[attr-defined]
    ticks = max((label.get_window_extent(renderer).width for label in axes.get_yticklabels()), default=0.0) / _DPI
    left = min(0.22 + ticks + 0.08, 0.45 * width)
    right = (
        0.3
        if chart.y.rows
        else 0.35 + min(0.073 * max(len(series.tag or series.label) for series in chart.series), 3.0)
    )
    bottom, top = 0.85 + _note_room(chart), 0.85 + (_LEGEND_LINE * (_legend_lines(chart) - 1) if chart.y.rows else 0.0)
    axes.set_position((left / width, bottom / height, (width - left - right) / width, (height - bottom - top) / height))


def _draw_markers(axes: Axes, chart: Chart) -> None:
    for index, marker in enumerate(chart.markers):
        axes.axvline(marker.at, color=_GREY, linewidth=1.0, linestyle=(0, (2, 2)), zorder=1.5)
        place = float(axes.transAxes.inverted().transform(axes.transData.transform((marker.at, 0.0)))[0])
        to_the_left = index == 0 if len(chart.markers) > 1 else place > 0.5  # at the right are the curves' names
        axes.annotate(
            marker.label,
            (marker.at, 1.0),
            xycoords=("data", "axes fraction"),
            xytext=(-4 if to_the_left else 4, 3),
            textcoords="offset points",
            color=_GREY,
            fontsize=8.5,
            ha="right" if to_the_left else "left",
            va="bottom",
        )


def _draw_tags(axes: Axes, series: Sequence[Series]) -> None:
    """Write every curve's name at its end, moved apart where they would overlap, with a thin line to the curve."""
    ends = [(item, *_last_point(item)) for item in series if np.isfinite(item.y).any()]
    if not ends:
        return
    size = min(9.5, 9.5 * 24 / max(len(ends), 1))
    heights = [float(axes.transData.transform((x, y))[1]) for _, x, y in ends]
    box = axes.get_window_extent()
    placed = spread(np.array(heights), size * 1.32 * _DPI / 72, box.y0, box.y1)
    for (item, x, y), height in zip(ends, placed, strict=True):
        level = float(axes.transAxes.inverted().transform((0.0, height))[1])
        axes.annotate(
            item.tag or item.label,
            (x, y),
            xytext=(1.035, level),
            textcoords="axes fraction",
            color=item.colour.light,
            fontsize=size,
            va="center",
            annotation_clip=False,
            arrowprops={
                "arrowstyle": "-",
                "color": item.colour.light,
                "linewidth": 0.7,
                "alpha": 0.6,
                "relpos": (0.0, 0.5),  # from the middle of the text a sloping line would strike through it
                "shrinkA": 2,
                "shrinkB": 2,
            },
        )


def _last_point(series: Series) -> tuple[float, float]:
    last = np.flatnonzero(np.isfinite(series.y))[-1]
    return float(series.x[last]), float(series.y[last])


def spread(wanted: FloatArray, gap: float, low: float, high: float) -> FloatArray:
    """Move positions as little as possible (least squares) so that neighbours are at least `gap` apart.

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


def _draw_row_legend(axes: Axes, chart: Chart) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    handles: list[Any] = [
        Patch(facecolor=bars.colour.light, alpha=0.3 if bars.pale else 1.0) for bars in chart.bars if bars.label
    ]
    for series in chart.series:
        handle = Line2D(
            [], [], color=series.colour.light, marker="o", linestyle="none", markersize=6.0, markeredgewidth=1.6
        )
        handle.set_markerfacecolor("white" if series.hollow else series.colour.light)
        handles.append(handle)
    if chart.linked:
        first, last = chart.series[0], chart.series[-1]
        axes.hlines(first.y, first.x, last.x, color=_GRID, linewidth=3.0, zorder=1.8)
    labels = _legend_labels(chart)
    columns = max(1, min(len(labels), _LEGEND_COLUMNS))
    legend = axes.legend(handles, labels, loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=columns, frameon=False)
    legend.set_in_layout(False)


def _draw_texts(figure: Figure, axes: Axes, chart: Chart, heading: str) -> None:
    width, height = figure.get_size_inches()
    left = 0.22 / width
    title = f"{heading} \u00b7 {chart.title}" if heading else chart.title
    figure.text(left, 1.0 - 0.2 / height, title, fontsize=12.5, fontweight="bold", va="top")
    if chart.y.title:
        figure.text(left, 1.0 - 0.47 / height, chart.y.title, color=_GREY, va="top")
    figure.text(left, 0.14 / height, "\n".join(_note_lines(chart)), color=_GREY, fontsize=8.5, va="bottom")
