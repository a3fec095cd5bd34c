"""Share of placements that stay, by release speed.

Counted are all placements of `eval` episodes of all tasks and training seeds, drag only.
Placements of policies alone (`rl`, `delta-N`) are kept apart from those of strategies that come to rest before they
release (`stop`, `ik`, `ik+`). A placement stays when it is goal-stabilizing.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np
import polars as pl

from perdure.home.evaluate.protocol import read_release, read_strategy
from perdure.home.sim.objects import KINDS
from perdure.report.axes import Axis
from perdure.report.curves import Curve, curve_chart
from perdure.report.render import Figure
from perdure.report.statistics import wilson
from perdure.report.theme import style
from perdure.studies.placement.names import GROUPS

EDGES = (0.0, 0.02, 0.05, 0.1, 0.15, 0.2, 0.3, np.inf)
"""Bounds of the intervals of speed in [m/s]."""
INTERVALS = tuple(f"{low:g} to {high:g}" if np.isfinite(high) else f"over {low:g}" for low, high in pairwise(EDGES))
"""Their names."""
FEWEST = 20
"""Placements; with fewer, the figure draws no point and the table shows no share."""
SHAPES = ("apples", "cans", "bowls", "boxes")
SCHEMA: dict[str, type[pl.DataType]] = {
    "interval": pl.Int64,
    "in_motion": pl.Boolean,
    "objects": pl.String,
    "placements": pl.Int64,
    "share_stayed": pl.Float64,
    "median_speed": pl.Float64,
}
"""Number of the interval between `EDGES`, whether released in motion, group of objects, count, share, [m/s]."""


def release_speeds(placements: pl.DataFrame) -> pl.DataFrame:
    """Return how many placements of each group and interval there are, and which share stayed; columns: SCHEMA."""
    found = placements.filter(split="eval")
    moving = {}
    for label in found["strategy"].unique():
        place, options = read_strategy(label)
        if options == read_strategy("rl drag")[1]:
            moving[label] = place == "rl" or read_release(place).delta > 1
    found = found.filter(pl.col("strategy").is_in(list(moving)))
    rows = found.select(
        pl.Series("interval", np.digitize(found["object_speed"].to_numpy(), EDGES[1:], right=True)),
        pl.col("strategy").replace_strict(moving, return_dtype=pl.Boolean).alias("in_motion"),
        pl.col("kind").replace_strict({name: GROUPS[kind.shape] for name, kind in KINDS.items()}).alias("objects"),
        pl.col("object_speed", "stabilizing"),
    )
    counts = rows.group_by("interval", "in_motion", "objects").agg(
        pl.len().alias("placements"),
        pl.col("stabilizing").mean().alias("share_stayed"),
        pl.col("object_speed").median().alias("median_speed"),
    )
    return counts.select(pl.col(name).cast(kind) for name, kind in SCHEMA.items()).sort(
        "interval", "in_motion", "objects"
    )


def speed_table(counts: pl.DataFrame) -> str:
    """Return which share stayed, in Markdown; one row for each interval."""
    heads = [(moving, group) for moving in (True, False) for group in SHAPES]
    names = [f"{group}, {'in motion' if moving else 'stopped'}" for moving, group in heads]
    lines = [f"| release speed [m/s] | {' | '.join(names)} |", "|---" * (len(names) + 1) + "|"]
    for number, name in enumerate(INTERVALS):
        cells = (_cell(counts.filter(interval=number, in_motion=moving, objects=group)) for moving, group in heads)
        lines.append(f"| {' | '.join((name, *cells))} |")
    return "\n".join(lines)


def _cell(part: pl.DataFrame) -> str:
    if part.is_empty():
        return "-"
    count, share = part["placements"].item(), part["share_stayed"].item()
    return f"{100 * share:.0f} % of {count}" if count >= FEWEST else f"{round(share * count)} of {count}"


def speed_figures(counts: pl.DataFrame) -> Iterator[Figure]:
    """Yield the figure, if there are enough placements: released in motion, share that stays, Wilson's interval."""
    drawn = counts.filter(pl.col("placements") >= FEWEST, in_motion=True)
    if drawn.is_empty():
        return
    curves = [_curve(number, group, drawn.filter(objects=group)) for number, group in enumerate(SHAPES)]
    yield Figure(
        "release-speed",
        "Placements that stay, by release speed",
        curve_chart(
            [curve for curve in curves if len(curve.x)],
            Axis("release speed of the object [m/s]", names=INTERVALS),
            Axis("share of placements that stay", percent=True),
        ),
        "Placements released in motion (policy alone, or trained to stay), all tasks, apartments with unseen layouts, "
        f"drag only. Each point: an interval of speed with at least {FEWEST} placements. "
        "Bars: 95 % Wilson score intervals that count placements as independent, although they share policies. "
        "Policies were varied, not speeds.",
    )


def _curve(number: int, group: str, part: pl.DataFrame) -> Curve:
    part = part.sort("interval")
    share, interval = part["share_stayed"].to_numpy(), part["interval"].cast(pl.Float64).to_numpy()
    bounds = [wilson(p, n) for p, n in zip(share, part["placements"], strict=True)]
    lower, upper = np.array(bounds, dtype=np.float64).reshape(-1, 2).T
    label = f"{group} (n = {part['placements'].sum():,})"
    return Curve(label, interval, share, style(number), lower, upper, marked=True, intervals="bars")
