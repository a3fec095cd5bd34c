"""Figures of placements: which objects stayed (figure 2-5), and how they were released."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from perdure.home.evaluate.outcomes.failure_causes import DROPPED_HEIGHT, THROWN_SPEED
from perdure.home.evaluate.page import words
from perdure.home.evaluate.page.comparison import Comparison
from perdure.report import theme, wording
from perdure.report.axes import Axis, FloatArray
from perdure.report.curves import Curve, Marker, curve_chart
from perdure.report.render import Figure
from perdure.report.rows import Bars, bar_chart

MOST_LEVELS = 300
"""Points of one distribution."""
SLOWEST = 0.001
"""In [m/s]: what is slower is drawn at this speed, because a logarithmic axis has no zero."""


def kind_figure(comparison: Comparison) -> Figure | None:
    """Return placements by kind of object, and how many did not stay; None when nothing was placed."""
    kinds = sorted(
        {
            row
            for strategy in comparison.strategies
            for row in comparison.kinds[strategy].select("kind", "cylinder").rows()
        }
    )
    if not kinds:
        return None
    bars = []
    for strategy, label, style in zip(comparison.strategies, comparison.labels, comparison.styles, strict=True):
        table = comparison.kinds[strategy]
        placed, failed = (table[name].to_numpy().astype(np.float64) for name in ("placements", "failures"))
        counts = table.select("failures", "placements", "rate").iter_rows()
        texts = [f"{bad} of {n} ({wording.share(rate)})" for bad, n, rate in counts]
        rows = [kinds.index(row) for row in table.select("kind", "cylinder").rows()]
        bars.append(Bars(label, rows, failed, texts, style, placed))
    wide = len(kinds) > 3
    return Figure(
        name="kinds",
        title="Placements that did not stay, by kind of object",
        chart=bar_chart(
            [words.kind(*each) for each in kinds], bars, Axis("placements"), theme.WIDE if wide else theme.WIDTH
        ),
        note="Pale: all placements of that kind. Solid: those that did not stay (are not goal-stabilizing).",
        wide=wide,
    )


def shape_figure(comparison: Comparison) -> Figure | None:
    """Return the share of cylinders among placements and among those that did not stay; None without cylinders."""
    names: list[str] = []
    shares: list[float] = []
    texts: list[str] = []
    for strategy, label in zip(comparison.strategies, comparison.labels, strict=True):
        if not comparison.shapes[strategy]["cylinder"].any():
            continue
        for column, what in (("placements", "placed"), ("failures", "did not stay")):
            counts = dict(comparison.shapes[strategy].select("cylinder", column).iter_rows())
            total, cylinders = sum(counts.values()), counts.get(True, 0)
            names.append(f"{label}: {what} (n = {total})")
            shares.append(cylinders / total if total else 0.0)
            texts.append(f"{cylinders} of {total}" + (f" ({wording.share(shares[-1])})" if total else ""))
    if not names:
        return None
    bars = [Bars("cylinders", range(len(names)), np.array(shares), texts, theme.style(1))]
    return Figure(
        name="cylinders",
        title="Cylinders among the placements",
        chart=bar_chart(names, bars, Axis("share of cylinders among the objects", percent=True)),
        note="Cylinders fail more often than other objects where their share is greater among those that did not stay.",
    )


@dataclass(frozen=True)
class Measure:
    """Something measured at the moment an object is let go."""

    column: str
    """Of `Analysis.placements`."""
    name: str
    title: str
    axis: str
    log: bool = False
    marker: Marker | None = None
    """A threshold of the failure causes."""


MEASURES = (
    Measure(
        "release_height",
        "release-height",
        "Height of the object at the release",
        "middle of the object above where it would rest [m]",
        marker=Marker(DROPPED_HEIGHT, "dropped from here on"),
    ),
    Measure(
        "object_speed",
        "release-object-speed",
        "Speed of the object at the release",
        "speed of the object [m/s]",
        log=True,
        marker=Marker(THROWN_SPEED, "limit for thrown"),
    ),
    Measure("tilt", "release-tilt", "Tilt of the object at the release", "angle from upright [deg]"),
    Measure(
        "base_speed", "release-base-speed", "Speed of the base at the release", "speed of the base [m/s]", log=True
    ),
)


def release_figure(comparison: Comparison, measure: Measure) -> Figure | None:
    """Return the empirical distribution of one measure for each strategy; None without placements."""
    drawn, shown = [], []
    for strategy, label, style in zip(comparison.strategies, comparison.labels, comparison.styles, strict=True):
        values = comparison.placements[strategy][measure.column].to_numpy()
        if len(values):
            shown.append(np.maximum(values, SLOWEST) if measure.log else values)
            drawn.append((label, style))
    if not drawn:
        return None
    low, high = float(min(map(np.min, shown))), float(max(map(np.max, shown)))
    if measure.log:
        low, high = SLOWEST, max(1.0, high)
    else:
        margin = 0.03 * (high - low)
        low, high = low - margin, high + margin
    pairs = zip(drawn, shown, strict=True)
    curves = [_distribution(label, values, style, low, high) for (label, style), values in pairs]
    marker = measure.marker
    return Figure(
        name=measure.name,
        title=measure.title,
        chart=curve_chart(
            curves,
            Axis(measure.axis, log=measure.log, low=low, high=high),
            Axis(
                f"share of placements at or below ({wording.sample(list(map(len, shown)), 'placement')})", percent=True
            ),
            markers=() if marker is None or not low < marker.at < high else (marker,),
        ),
        note=f"Speeds below {SLOWEST} m/s are drawn there." if measure.log else "",
    )


def _distribution(label: str, values: FloatArray, style: theme.Style, low: float, high: float) -> Curve:
    """Return the empirical distribution function from low to high, thinned where there are many values."""
    levels = np.linspace(0.0, 1.0, min(len(values), MOST_LEVELS) + 1)
    places = np.quantile(values, levels[1:], method="inverted_cdf")
    return Curve(label, np.array([low, *np.repeat(places, 2), high]), np.repeat(levels, 2), style)
