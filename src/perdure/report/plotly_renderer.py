"""A chart for the page: the data and layout that plotly.js draws."""

from __future__ import annotations

from typing import Any

import numpy as np

from perdure.report.charts import Axis, Bars, Chart, Series

HEIGHT = 380
ROW_HEIGHT = 30
LINE_HEIGHT = 18
"""Of each of several bars in one row."""
LEGEND_HEIGHT = 14
"""Room for the legend's part of one series."""
_DASHES = {"solid": "solid", "dash": "dash", "dot": "dot", "dashdot": "dashdot"}


def render_plotly(chart: Chart, dark: bool) -> dict[str, Any]:
    """Data and layout of a chart, as plain JSON values.

    Args:
        chart: What to draw.
        dark: For a dark page; both versions share data but for colours.
    """
    data = [_bars(bars, dark) for bars in chart.bars]
    data += [trace for series in chart.series for trace in _traces(series, dark, bool(chart.y.rows))]
    return {"data": data, "layout": _layout(chart, dark)}


def _bars(bars: Bars, dark: bool) -> dict[str, Any]:
    colour = bars.colour.dark if dark else bars.colour.light
    trace = {
        "type": "bar",
        "orientation": "h",
        "name": _escape(bars.label),
        "showlegend": bool(bars.label),
        "legendgroup": bars.label,
        "y": _numbers(bars.rows),
        "base": _numbers(bars.start),
        "x": _numbers(bars.end - bars.start),
        "width": bars.thickness,
        "marker": {"color": colour + "4d" if bars.pale else colour, "line": {"width": 0}},
        "hoverinfo": "skip",
    }
    if bars.texts:
        trace |= {
            "text": [_escape(text) for text in bars.texts],
            "textposition": "inside" if bars.inside else "outside",
            "insidetextanchor": "middle",
            "textangle": 0,
            "constraintext": "inside" if bars.inside else "none",
            "cliponaxis": False,
            "textfont": {"size": 11.5} | ({"color": "#16181b" if dark else "#ffffff"} if bars.inside else {}),
            "hovertext": [_escape(": ".join(filter(None, (bars.label, text)))) for text in bars.texts],
            "hoverinfo": "text",
        }
    return trace


def _colour(series: Series, dark: bool) -> str:
    return series.colour.dark if dark else series.colour.light


def _numbers(values: Any) -> list[float | None]:
    return [float(value) if np.isfinite(value) else None for value in values]


def _traces(series: Series, dark: bool, rows: bool) -> list[dict[str, Any]]:
    colour = _colour(series, dark)
    line: dict[str, Any] = {
        "type": "scatter",
        "name": _escape(series.label),
        "legendgroup": series.label,
        "x": _numbers(series.x),
        "y": _numbers(series.y),
        "mode": "+".join(["lines"] * series.line + ["markers"] * series.points),
        "line": {"color": colour, "width": 2.2, "dash": _DASHES[series.dash]},
        "marker": {"color": colour, "size": 8, "symbol": "circle-open" if series.hollow else "circle"},
        "hovertemplate": "%{y:,.4~g}<extra>" + _escape(series.label) + "</extra>",
    }
    if series.group:
        line["legendgrouptitle"] = {"text": _escape(series.group)}
        line["legendgroup"] = series.group
    if series.lower is None or series.upper is None or not np.isfinite(series.lower).any():
        return [line]
    if rows or series.points:
        axis = "x" if rows else "y"
        centre = series.x if rows else series.y
        line[f"error_{axis}"] = {
            "type": "data",
            "symmetric": False,
            "array": _numbers(series.upper - centre),
            "arrayminus": _numbers(centre - series.lower),
            "thickness": 1.5,
            "width": 0,
        }
        return [line]
    return [_band(series, colour, line["legendgroup"]), line]


def _band(series: Series, colour: str, group: str) -> dict[str, Any]:
    assert series.lower is not None
    assert series.upper is not None
    known = np.isfinite(series.lower) & np.isfinite(series.upper)
    x = series.x[known]
    return {
        "type": "scatter",
        "x": _numbers(np.concatenate([x, x[::-1]])),
        "y": _numbers(np.concatenate([series.upper[known], series.lower[known][::-1]])),
        "fill": "toself",
        "fillcolor": colour + "26",
        "line": {"width": 0},
        "hoverinfo": "skip",
        "showlegend": False,
        "legendgroup": group,
        "mode": "lines",
    }


def _layout(chart: Chart, dark: bool) -> dict[str, Any]:
    ink, grid = ("#d5d8dd", "#33373d") if dark else ("#3b3f46", "#e4e6ea")
    rows = len(chart.y.rows)
    layout: dict[str, Any] = {
        "height": _height(chart),
        "barmode": "overlay",
        "uniformtext": {"mode": "hide", "minsize": 11},
        "margin": {"l": 12, "r": 16, "t": 40, "b": 12},
        "paper_bgcolor": "rgba(0,0,0,0)",
        "plot_bgcolor": "rgba(0,0,0,0)",
        "font": {"color": ink, "size": 13, "family": "system-ui, sans-serif"},
        "hovermode": "closest" if rows else "x unified",
        "legend": {"orientation": "h", "yref": "container", "y": 0.0, "yanchor": "bottom", "groupclick": "toggleitem"},
        "xaxis": _axis(chart.x, grid, ink) | {"title": {"text": _escape(chart.x.title), "standoff": 8}},
        "yaxis": _axis(chart.y, grid, ink, downwards=True),
        "shapes": [
            {
                "type": "line",
                "x0": m.at,
                "x1": m.at,
                "y0": 0,
                "y1": 1,
                "yref": "paper",
                "line": {"color": ink, "width": 1, "dash": "dot"},
            }
            for m in chart.markers
        ],
        "annotations": _annotations(chart),
    }
    return layout


def _annotations(chart: Chart) -> list[dict[str, Any]]:
    """The title of the upright axis, level so that it can be read, and the names of the markers."""
    return [
        {
            "x": 0,
            "xref": "paper",
            "xanchor": "left",
            "y": 1.0,
            "yref": "paper",
            "yanchor": "bottom",
            "yshift": 10,
            "text": _escape(chart.y.title),
            "showarrow": False,
            "font": {"size": 12},
        },
        *(
            {
                "x": float(np.log10(m.at)) if chart.x.log else m.at,
                "y": 1,
                "yref": "paper",
                "text": _escape(m.label),
                "showarrow": False,
                "textangle": -90,
                "xanchor": "right",
                "yanchor": "top",
                "font": {"size": 11},
            }
            for m in chart.markers
        ),
    ]


def _height(chart: Chart) -> int:
    if not chart.y.rows:
        return HEIGHT + LEGEND_HEIGHT * len(chart.series)
    return 150 + max(ROW_HEIGHT, LINE_HEIGHT * chart.row_lines + 10) * len(chart.y.rows)


def _axis(axis: Axis, grid: str, ink: str, downwards: bool = False) -> dict[str, Any]:
    result: dict[str, Any] = {
        "gridcolor": grid,
        "zerolinecolor": grid,
        "linecolor": ink,
        "automargin": True,
    }
    if axis.log:
        whole = axis.low is None or axis.low >= 1.0
        result |= {"type": "log", "dtick": 1, "exponentformat": "none", "tickformat": ",.0f" if whole else "~g"}
    if axis.percent:
        result |= {"tickformat": ".0%"}
    if axis.ticks is not None:
        result |= {"tickvals": list(axis.ticks)}
    if axis.low is not None and axis.high is not None:
        ends = [np.log10(axis.low), np.log10(axis.high)] if axis.log else [axis.low, axis.high]
        margin = 0.02 * (ends[1] - ends[0])
        result["range"] = [float(ends[0] - margin), float(ends[1] + margin)]
    if axis.rows:
        last = len(axis.rows) - 1
        result |= {
            "tickvals": list(range(len(axis.rows))),
            "ticktext": [_escape(row) for row in axis.rows],
            "range": [last + 0.6, -0.6] if downwards else [-0.3, last + 0.3],
        }
    return result


def _escape(text: str) -> str:
    """Plotly reads a little HTML in labels; labels come from users."""
    return text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
