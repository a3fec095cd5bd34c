"""How fast an object may move when it is released: the share of placements that stay, by release speed.

python benchmarks/release_speed.py HOME_RUNS

HOME_RUNS is the `--out` of `perdure home run`. Counted are all placements of eval episodes in the world without rolling
resistance, of all tasks and training seeds there. Placements of policies alone (`rl`, `delta-N`) are kept apart from
those of strategies that come to rest before they release (`stop`, `ik`, `ik+`). A placement stays when it is
goal-stabilizing. Writes the table of docs/home/results.md and docs/images/home-release-speed.png.
"""

from __future__ import annotations

import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
import polars as pl
from home_protocol import PAGE
from home_tables import GROUPS
from marks import put

from perdure.home.evaluate.outcomes import analyze
from perdure.home.evaluate.page import read_assignment
from perdure.home.evaluate.protocol import read_release
from perdure.home.evaluate.protocol.naming import read_strategy
from perdure.home.sim.objects import KINDS
from perdure.report.axes import Axis
from perdure.report.curves import Curve, curve_chart
from perdure.report.render import Figure, render
from perdure.report.statistics import wilson
from perdure.report.theme import style
from perdure.runs import write_whole

PICTURE = PAGE.parents[1] / "images" / "home-release-speed.png"
EDGES = (0.0, 0.02, 0.05, 0.1, 0.15, 0.2, 0.3, np.inf)
"""Speeds in [m/s]."""
FEWEST = 20
"""Placements; of fewer the picture draws no point and the table has no share."""
SHAPES = ("apples", "cans", "bowls", "boxes")


def placements(folder: Path) -> pl.DataFrame:
    """One row for each: its group of objects, its speed's interval, who let go, whether it stayed."""
    records, _ = read_assignment(sorted(folder.rglob("logs.parquet")))
    found = analyze(records).placements.filter(split="eval")
    alone = {}
    for label in found["strategy"].unique():
        arm, options = read_strategy(label)
        if options == read_strategy("rl drag")[1]:
            alone[label] = arm == "rl" or read_release(arm).delta > 1
    found = found.filter(pl.col("strategy").is_in(list(alone)))
    return found.select(
        pl.col("kind").replace_strict({name: GROUPS[kind.shape] for name, kind in KINDS.items()}).alias("group"),
        pl.col("strategy").replace_strict(alone).alias("alone"),
        pl.Series("interval", np.digitize(found["object_speed"].to_numpy(), EDGES[1:], right=True)),
        pl.col("object_speed").alias("speed"),
        pl.col("stabilizing").alias("stayed"),
    )


def table(counts: pl.DataFrame) -> str:
    """Of how many stayed how many, in Markdown; one row for each interval."""
    heads = [(alone, group) for alone in (True, False) for group in SHAPES]
    names = [f"{group}, {'in motion' if alone else 'stopped'}" for alone, group in heads]
    lines = [f"| release speed [m/s] | {' | '.join(names)} |", "|---" * (len(names) + 1) + "|"]
    for number, (low, high) in enumerate(pairwise(EDGES)):
        cells = [f"{low:g} to {high:g}" if np.isfinite(high) else f"over {low:g}"]
        for alone, group in heads:
            part = counts.filter(interval=number, alone=alone, group=group)
            stayed, count = (part["stayed"].item(), part["count"].item()) if len(part) else (0, 0)
            few = f"{stayed} of {count}" if count else "-"
            cells.append(f"{100 * stayed / count:.0f} % of {count}" if count >= FEWEST else few)
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def picture(counts: pl.DataFrame) -> Figure:
    """Policies alone: share that stays over the interval's median speed, with Wilson's interval."""
    curves = []
    for number, group in enumerate(SHAPES):
        part = counts.filter(pl.col("count") >= FEWEST, alone=True, group=group).sort("interval")
        share = (part["stayed"] / part["count"]).to_numpy()
        bounds = [wilson(p, n) for p, n in zip(share, part["count"], strict=True)]
        lower, upper = np.array(bounds, dtype=np.float64).reshape(-1, 2).T
        label, speed = f"{group} (n = {part['count'].sum():,})", part["speed"].to_numpy()
        curves.append(Curve(label, speed, share, style(number), lower, upper, marked=True, intervals="bars"))
    return Figure(
        "home-release-speed",
        "How fast may an object move when it is released?",
        curve_chart(
            curves,
            Axis("release speed of the object [m/s]"),
            Axis("share of placements that stay", percent=True),
        ),
        "Placements released in motion (policy alone, or trained to stay), all tasks, apartments with unseen layouts, "
        f"no rolling resistance. Each point: an interval of speed with at least {FEWEST} placements, at their median "
        "speed; bars: 95 % Wilson score intervals over placements.",
    )


def main(folder: Path) -> None:
    """Counts, writes, prints."""
    grouped = placements(folder).group_by("group", "alone", "interval")
    counts = grouped.agg(pl.len().alias("count"), pl.col("stayed").sum(), pl.col("speed").median())
    text = table(counts)
    write_whole(PAGE, put(PAGE.read_text(), "release_speed", text))
    write_whole(PICTURE, render(picture(counts)))
    print(text)


if __name__ == "__main__":
    if len(sys.argv) < 2:
        sys.exit(__doc__)
    main(Path(sys.argv[1]))
