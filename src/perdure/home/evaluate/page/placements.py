"""Charts of placements: which objects stayed (figure 2-5), and how they were let go."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from perdure.home.evaluate.outcomes.mechanisms import DROPPED_HEIGHT, THROWN_SPEED
from perdure.home.evaluate.page.comparison import Comparison, percent
from perdure.report import wording
from perdure.report.charts import Axis, Bars, Chart, FloatArray, Marker, Series
from perdure.report.palette import FADED, Colour, category

MOST_LEVELS = 300
"""Points of one distribution."""
SLOWEST = 0.001
"""In [m/s]: what is slower is drawn at this speed, because a logarithmic axis has no zero."""


def kind_chart(comparison: Comparison) -> Chart | None:
    """How many objects of each kind were placed and how many of them did not stay; None when nothing was placed."""
    kinds = sorted({row for arm in comparison.arms for row in comparison.kinds[arm].select("kind", "cylinder").rows()})
    if not kinds:
        return None
    lines, bars, most = len(comparison.arms), [], 1
    wide = len(kinds) > 3
    for k, (arm, colour) in enumerate(zip(comparison.arms, comparison.colours, strict=True)):
        table = comparison.kinds[arm]
        numbers = [kinds.index(row) for row in table.select("kind", "cylinder").rows()]
        rows = np.array(numbers) + (k + 0.5) / lines * 0.84 - 0.42
        placed, failed = (table[name].to_numpy().astype(np.float64) for name in ("placements", "failures"))
        texts = tuple(
            f"{bad} of {n} ({percent(rate)})"
            for bad, n, rate in table.select("failures", "placements", "rate").iter_rows()
        )
        bars.append(Bars("", rows, 0.0 * placed, placed, colour, 0.76 / lines, texts, pale=True))
        bars.append(Bars(arm, rows, 0.0 * failed, failed, colour, 0.76 / lines))
        most = max(most, int(placed.max(initial=0.0)))
    return Chart(
        name="kinds",
        title="Placements by kind of object",
        x=Axis("placements", low=0.0, high=(1.2 if wide else 1.5) * most),
        y=Axis("", rows=tuple(f"{kind} (cylinder)" if cylinder else kind for kind, cylinder in kinds)),
        series=(),
        bars=tuple(bars),
        row_lines=lines,
        note="Pale: all placements of that kind. Solid: those that did not stay (are not goal-stabilizing).",
        wide=wide,
    )


def shape_chart(comparison: Comparison) -> Chart | None:
    """What share of the placements, and of those that did not stay, are cylinders; None where none was placed."""
    arms = [arm for arm in comparison.arms if comparison.shapes[arm]["cylinder"].any()]
    if not arms:
        return None
    rows: list[str] = []
    parts: dict[bool, list[tuple[float, float, float, str]]] = {True: [], False: []}
    for arm in arms:
        for column, words in (("placements", "placed"), ("failures", "did not stay")):
            counts = dict(comparison.shapes[arm].select("cylinder", column).iter_rows())
            total, start = sum(counts.values()), 0.0
            for cylinder in (True, False):
                count = counts.get(cylinder, 0)
                if count:
                    end = start + count / total
                    text = f"{count} ({wording.share(count / total)})"
                    parts[cylinder].append((float(len(rows)), start, end, text))
                    start = end
            rows.append(f"{arm}: {total} {words}")
    return Chart(
        name="cylinders",
        title="Cylinders among the placements",
        x=Axis("share", percent=True, low=0.0, high=1.0),
        y=Axis("", rows=tuple(rows)),
        series=(),
        bars=tuple(
            _stacked("cylinders" if cylinder else "other objects", parts[cylinder], cylinder)
            for cylinder in (True, False)
            if parts[cylinder]
        ),
        note="Cylinders fail more often than others where their share grows from an arm's first row to its second.",
    )


def _stacked(label: str, parts: list[tuple[float, float, float, str]], cylinder: bool) -> Bars:
    rows, start, end, texts = zip(*parts, strict=True)
    colour = category(1) if cylinder else FADED
    return Bars(label, np.array(rows), np.array(start), np.array(end), colour, 0.72, texts, inside=True)


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
    """A threshold of the failure mechanisms."""


MEASURES = (
    Measure(
        "release_height",
        "release-height",
        "Height at the release",
        "middle of the object above where it would rest [m]",
        marker=Marker(DROPPED_HEIGHT, "dropped from here on"),
    ),
    Measure(
        "object_speed",
        "release-object-speed",
        "Speed of the object at the release",
        "[m/s]",
        log=True,
        marker=Marker(THROWN_SPEED, "thrown from here on"),
    ),
    Measure("tilt", "release-tilt", "Tilt of the object at the release", "angle from upright [deg]"),
    Measure("base_speed", "release-base-speed", "Speed of the base at the release", "[m/s]", log=True),
)


def release_chart(comparison: Comparison, measure: Measure) -> Chart | None:
    """The distribution of one measure for each arm, as the share of placements at or below; None without any."""
    curves, shown = [], []
    for arm, colour in zip(comparison.arms, comparison.colours, strict=True):
        values = comparison.placements[arm][measure.column].to_numpy()
        if len(values):
            shown.append(np.maximum(values, SLOWEST) if measure.log else values)
            curves.append(_distribution(arm, shown[-1], colour))
    if not curves:
        return None
    low, high = min(map(np.min, shown)), max(map(np.max, shown))
    if measure.log:
        low, high = SLOWEST, max(1.0, float(high))
    marker = measure.marker
    return Chart(
        name=measure.name,
        title=measure.title,
        x=Axis(measure.axis, log=measure.log, low=float(low), high=float(high) if high > low else float(low) + 1.0),
        y=Axis("share of placements at or below", percent=True, low=0.0, high=1.0),
        series=tuple(curves),
        markers=() if marker is None or not low < marker.at < high else (marker,),
        note=f"Speeds below {SLOWEST} m/s are drawn there." if measure.log else "",
    )


def _distribution(arm: str, values: FloatArray, colour: Colour) -> Series:
    """The steps of the empirical distribution function; quantiles of it where there are many values."""
    levels = np.linspace(0.0, 1.0, min(len(values), MOST_LEVELS) + 1)
    places = np.quantile(values, levels[1:], method="inverted_cdf")
    return Series(arm, np.repeat(places, 2), np.repeat(levels, 2)[1:-1], colour, tag=f"{arm} ({len(values)})")
