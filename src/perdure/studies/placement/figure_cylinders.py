"""Figure 2-5: placements of cylinders and of other objects that did not stay."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from perdure.home.evaluate.page import words
from perdure.home.sim.objects import KINDS
from perdure.report import theme, wording
from perdure.report.axes import Axis
from perdure.report.render import Figure
from perdure.report.rows import Bars, bar_chart
from perdure.studies.placement.names import SPLITS, TITLES
from perdure.studies.placement.results import Results, Row, chosen, strategy_and_world

SHOWN = ("rl", "stop", "ik")
WORDS = {True: "cylinders", False: "other objects"}


def cylinder_figures(results: Results) -> Iterator[Figure]:
    """Yield a figure for each split: tasks in which cylinders are placed, drag only."""
    for split in SPLITS:
        found = chosen(results.rows, split, "drag")
        rows = [row for row in found if strategy_and_world(row)[0] in SHOWN and shape_counts(row)[True][1]]
        if rows:
            yield _figure(rows, split)


def shape_counts(row: Row) -> dict[bool, tuple[int, int]]:
    """Return (placements that did not stay, placements) of cylinders (True) and of other objects (False)."""
    counts = {}
    for cylinder in WORDS:
        kinds = [kind for name, kind in row["kinds"].items() if (KINDS[name].shape == "cylinder") == cylinder]
        counts[cylinder] = sum(kind["not_stable"] for kind in kinds), sum(kind["placements"] for kind in kinds)
    return counts


def _figure(rows: list[Row], split: str) -> Figure:
    names, failed, placed, texts = [], [], [], []
    for row in rows:
        who = words.describe(strategy_and_world(row)[0])
        for cylinder, (bad, count) in shape_counts(row).items():
            names.append(f"{TITLES[row['task']]}, {who}: {WORDS[cylinder]}")
            failed.append(float(bad))
            placed.append(float(count))
            texts.append(f"{bad:,} of {count:,}" + (f" ({wording.share(bad / count)})" if count else ""))
    bars = [Bars("did not stay", range(len(names)), np.array(failed), texts, theme.style(1), np.array(placed))]
    return Figure(
        f"figure-2-5-{split}",
        "Placements of cylinders and of other objects",
        bar_chart(names, bars, Axis("placements"), theme.WIDE),
        f"Apartments with {SPLITS[split]}, drag only. Pale: all placements. Solid: those that did not stay "
        "(are not goal-stabilizing).",
        wide=True,
    )
