"""Figures of the study beside those of every home page: strategies by world, placements that stay by release speed."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import polars as pl

from perdure.home.evaluate.analysis import GROUP, outcome_shares
from perdure.home.evaluate.comparison import describe_task, make_views
from perdure.home.evaluate.figures import outcome_figure, shape_figure, stage_figure
from perdure.report import wording
from perdure.report.charts import Axis, Curve, Figure, Points, curve_chart, point_chart, slug, style
from perdure.stats import clopper_pearson
from studies.placement.grid import WORLDS
from studies.placement.tables import INTERVALS, MIN_PLACEMENTS, SHAPES, Tables, success_rows

LABELS = {"rl": "policy alone", "stop": "stop, then release", "ik": "stop, lower 5 cm, release"}
SHOWN = tuple(f"{place} drag" for place in ("rl", "delta-200", "stop", "ik"))
"""Strategies in the figures of every task."""


def draw_figures(tables: Tables) -> Iterator[Figure]:
    """Yield every figure for which there are rows: both below, and for each task and split those of the thesis."""
    yield from strategy_figures(tables)
    yield from speed_figures(tables["release-speed"])
    for view in make_views(view_tables(tables)):
        for figure in filter(None, (stage_figure(view), outcome_figure(view), shape_figure(view))):
            note = f"Apartments of {view.split}, drag only. {figure.note}"
            yield replace(figure, name=slug(view.name, figure.name), heading=view.title, note=note)


def view_tables(tables: Tables) -> Tables:
    """Return the tables that figures of home pages are made of, with drag only."""
    names = ("success", "stages", "outcomes", "kinds")
    here = {name: tables[name].filter(pl.col("strategy").is_in(SHOWN)) for name in names}
    return {**here, "outcomes": outcome_shares(here["outcomes"])}


def strategy_figures(tables: Tables) -> Iterator[Figure]:
    """Yield the figure of release strategies: every task on unseen layouts, then SetTable in the other worlds."""
    rows = [row for row in success_rows(tables, "eval", places=LABELS) if row["world"] in ("drag", *list(WORLDS)[:5])]
    rows = [row for row in rows if row["world"] == "drag" or row["task"] == "set_table"]
    places = list(dict.fromkeys((row["task"], row["world"]) for row in rows))
    places.sort(key=lambda each: each[1] != "drag")
    if not places:
        return
    names = [", ".join(filter(None, (describe_task(task), _world(world)))) for task, world in places]
    points = []
    for number, (place, label) in enumerate(LABELS.items()):
        mine = [row for row in rows if row["place"] == place]
        at = [places.index((row["task"], row["world"])) for row in mine]
        mean, lower, upper = (
            np.array([row[f"stabilizing {name}"] for row in mine], dtype=np.float64)
            for name in ("mean", "lower", "upper")
        )
        several = np.array([row["train_seeds"] > 1 for row in mine], dtype=bool)
        seeds = [tables["seeds"].filter(**{name: row[name] for name in GROUP})["stabilizing"].to_list() for row in mine]
        lower, upper = (np.where(several, bound, np.nan) for bound in (lower, upper))
        points.append(Points(label, at, mean, style(number), lower, upper, seeds))
    trained = wording.sample([row["train_seeds"] for row in rows], "training seed").removesuffix(" each")
    per_seed = wording.sample([row["episodes"] // row["train_seeds"] for row in rows], "episode")
    yield Figure(
        "strategies",
        "Does the object stay where it was put?",
        point_chart(names, points, Axis("share of episodes whose objects all stay until the end", percent=True)),
        "Apartments with a layout never seen in training. Unless named otherwise only drag slows rolling objects. "
        f"Filled: mean of {trained}. Small open marks: each seed ({per_seed}). "
        "Bars: 95 % Student t intervals over the training seeds.",
    )


def _world(world: str) -> str:
    return "" if world == "drag" else WORLDS[world].removeprefix("drag only, ")


def speed_figures(counts: pl.DataFrame) -> Iterator[Figure]:
    """Yield the figure, if there are enough placements: released in motion, share that stays, its interval."""
    drawn = counts.filter(pl.col("placements") >= MIN_PLACEMENTS, in_motion=True)
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
        f"drag only. Each point: an interval of speed with at least {MIN_PLACEMENTS} placements. "
        "Bars: 95 % Clopper-Pearson intervals that count placements as independent, although they share policies. "
        "Policies were varied, not speeds.",
    )


def _curve(number: int, group: str, part: pl.DataFrame) -> Curve:
    part = part.sort("interval")
    share, interval = part["share_stayed"].to_numpy(), part["interval"].cast(pl.Float64).to_numpy()
    bounds = [clopper_pearson(p, n) for p, n in zip(share, part["placements"], strict=True)]
    lower, upper = np.array(bounds, dtype=np.float64).reshape(-1, 2).T
    label = f"{group} (n = {part['placements'].sum():,})"
    return Curve(label, interval, share, style(number), lower, upper, marked=True, intervals="bars")
