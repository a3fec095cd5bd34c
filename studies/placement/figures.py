"""Figures of the study beside those of every home page: success by rolling resistance, stays by release speed."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, replace

import numpy as np
import polars as pl

from perdure.home.evaluate.analysis import outcome_shares
from perdure.home.evaluate.comparison import describe, make_views
from perdure.home.evaluate.figures import outcome_figure, shape_figure, stage_figure
from perdure.home.evaluate.strategy import CALM, Strategy
from perdure.home.sim.scene import LEVERS
from perdure.report import wording
from perdure.report.charts import Axis, Curve, Figure, curve_chart, slug, style
from perdure.stats import clopper_pearson
from studies.placement.grid import DRAG, TASKS
from studies.placement.tables import INTERVALS, MIN_PLACEMENTS, SETTING, SHAPES, Tables, success_rows

SHOWN = {
    "eval": [Strategy(place, planner="closed", fallback="oracle") for place in ("rl", "stop", "guarded")],
    "val": [Strategy(place, DRAG) for place in ("rl", "ik")],
}
"""Strategies in the figures of every task, by split: the closed loop, and what the thesis compares."""


def draw_figures(tables: Tables) -> Iterator[Figure]:
    """Yield every figure for which there are rows: both below, and for each task and split those of the thesis."""
    yield from rolling_figures(tables)
    yield from speed_figures(tables["release-speed"])
    for split, shown in SHOWN.items():
        names = ("success", "stages", "outcomes", "kinds")
        wanted = pl.DataFrame([{"split": split, **asdict(strategy)} for strategy in shown])
        keys = ("split", *SETTING)
        here = {
            name: tables[name]
            .join(wanted, on=keys, how="semi", maintain_order="left")
            .with_columns(label=pl.lit(""), disturbance=pl.lit(CALM))
            for name in names
        }
        for view in make_views({**here, "outcomes": outcome_shares(here["outcomes"])}):
            for figure in filter(None, (stage_figure(view), outcome_figure(view), shape_figure(view))):
                yield replace(figure, name=slug(view.name, figure.name), heading=view.title)


def rolling_figures(tables: Tables) -> Iterator[Figure]:
    """Yield the figure, if there are rows: success on SetTable in the closed loop by rolling resistance."""
    rows = [row for row in success_rows(tables) if (row["task"], row["planner"]) == (TASKS[0], "closed")]
    curves = []
    drawn = []
    for number, place in enumerate(dict.fromkeys(row["place"] for row in rows)):
        mine = [row for row in rows if row["place"] == place]
        if len(mine) == len(LEVERS):
            drawn += mine
            mean, lower, upper = (
                np.array([row[f"stabilizing {name}"] for row in mine], dtype=np.float64)
                for name in ("mean", "lower", "upper")
            )
            x = np.arange(len(LEVERS), dtype=np.float64)
            curves.append(
                Curve(describe(Strategy(place)), x, mean, style(number), lower, upper, marked=True, intervals="bars")
            )
    if curves:
        seeds = wording.sample([row["train_seeds"] for row in drawn], "training seed")
        episodes = wording.sample([row["episodes"] for row in drawn], "episode")
        names = tuple(f"{1000 * lever:g} mm" for lever in LEVERS)
        yield Figure(
            "rolling",
            "SetTable: every object stays, by rolling resistance",
            curve_chart(
                curves,
                Axis("rolling resistance, lever arm of the weight", names=names),
                Axis("share of episodes whose objects all stay until the end", percent=True),
            ),
            "Closed loop, apartments with an unseen layout. At 0 mm only drag slows a rolling object, as in Habitat; "
            f"1.2 mm is the default. {seeds}; {episodes}. Bars: 95 % intervals ({drawn[0]['method']}).",
        )


def speed_figures(counts: pl.DataFrame) -> Iterator[Figure]:
    """Yield the figure, if there are enough placements without a hand-over: share that stays, its interval."""
    drawn = counts.filter(pl.col("placements") >= MIN_PLACEMENTS, hand_over=False)
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
        "Placements without a hand-over, closed loop, an unseen layout, drag only. Those of the policy that was "
        "trained to release at rest are on SetTable only. "
        f"Each point: an interval of speed with at least {MIN_PLACEMENTS} placements. "
        "Bars: 95 % Clopper-Pearson intervals that count placements as independent, although they share policies. "
        "Policies were varied, not speeds.",
    )


def _curve(number: int, group: str, part: pl.DataFrame) -> Curve:
    part = part.sort("interval")
    share = part["share_stayed"].to_numpy()
    interval = part["interval"].cast(pl.Float64).to_numpy()
    bounds = [clopper_pearson(p, n) for p, n in zip(share, part["placements"], strict=True)]
    lower, upper = np.array(bounds, dtype=np.float64).reshape(-1, 2).T
    label = f"{group} (n = {part['placements'].sum():,})"
    return Curve(label, interval, share, style(number), lower, upper, marked=True, intervals="bars")
