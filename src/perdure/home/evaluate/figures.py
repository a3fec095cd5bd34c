"""Figures of release strategies side by side, from the tables of `analysis`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from perdure.home.evaluate.comparison import (
    MEASURES,
    WORDS,
    Measure,
    View,
    by_shape,
    describe_kind,
    describe_outcome,
    describe_stage,
    listed,
    mode_labels,
)
from perdure.home.evaluate.outcomes import COUNTINGS, Counting
from perdure.home.tasks.tasks import get_task
from perdure.report import charts, wording
from perdure.report.charts import Axis, Bars, Curve, Figure, Points, bar_chart, curve_chart, point_chart, slug
from perdure.stats import FEWEST_FOR_INTERVAL, FloatArray

SLOWEST = 0.001
"""In [m/s]: what is slower is drawn at this speed, because a logarithmic axis has no zero."""
MOST_LEVELS = 300
"""Points of one distribution."""


def make_figures(view: View) -> list[Figure]:
    """Return all figures of one task and split; those with nothing to show are left out."""
    drawn = [success_figure(view), shape_figure(view), kind_figure(view), outcome_figure(view), stage_figure(view)]
    drawn += [mode_figure(view, counting) for counting in reversed(COUNTINGS)]
    drawn += [release_figure(view, column) for column in ("release_height", "object_speed", "tilt", "base_speed")]
    return [replace(each, name=slug(view.name, each.name), heading=view.title) for each in drawn if each is not None]


def success_figure(view: View) -> Figure:
    """Return the success of the whole task: a row for each strategy, a point for each way of counting."""
    seeds = [view.rows("seeds", strategy)["stabilizing"].to_list() for strategy in view.strategies]
    members = [each if len(each) > 1 else [] for each in seeds]

    def points(counting: Counting) -> Points:
        rows = [view.success(strategy) for strategy in view.strategies]
        drawn = np.array([view.has_interval(strategy) for strategy in view.strategies])
        mean, lower, upper = (
            np.array([row[f"{counting} {name}"] for row in rows], dtype=np.float64)
            for name in ("mean", "lower", "upper")
        )
        lower, upper = (np.where(drawn, bound, np.nan) for bound in (lower, upper))
        latched = counting == "latched"
        style = charts.Style(charts.FADED, shape="square") if latched else charts.style(0)
        return Points(WORDS[counting], range(len(rows)), mean, style, lower, upper, None if latched else members)

    return Figure(
        name="success",
        title="Success of the whole task",
        chart=point_chart(
            [f"{label} (n = {view.success(strategy)['episodes']:,})" for strategy, label, _ in view.shown],
            [points(counting) for counting in COUNTINGS],
            Axis("share of n episodes", percent=True),
        ),
        note="Latched: a stage counts once its conditions hold, whatever follows. Goal-stabilizing: objects also stay. "
        + ("Rings: each training seed. " if any(members) else "")
        + error_note(view)
        + unequal_note(view),
    )


def stage_figure(view: View) -> Figure | None:
    """Return the success per stage: a curve for each strategy and way of counting."""
    names = tuple(describe_stage(each) for each in get_task(view.task).stages)
    curves = []
    for strategy, label, style in view.shown:
        for counting in reversed(COUNTINGS):
            table = view.rows("stages", strategy, counting=counting)
            lasting = counting == "stabilizing"
            bounds = np.full((2, len(names)), np.nan)
            if lasting and view.has_interval(strategy):
                bounds[:, -1] = [view.success(strategy)[f"stabilizing {name}"] for name in ("lower", "upper")]
            curves.append(
                Curve(
                    label if lasting else f"{label}: latched",
                    np.arange(len(names), dtype=np.float64),
                    table["mean"].to_numpy(),
                    replace(style, dash=charts.SOLID if lasting else (2, 3)),
                    lower=bounds[0],
                    upper=bounds[1],
                    marked=lasting,
                    named=lasting,
                    intervals="last",
                )
            )
    sample = wording.sample([view.success(strategy)["episodes"] for strategy in view.strategies], "episode")
    return Figure(
        name="stages",
        title="Success per stage",
        chart=curve_chart(
            curves,
            Axis("stage of the task, in order", names=names),
            Axis(f"share of episodes that reached it ({sample})", percent=True),
            width=charts.WIDE,
        ),
        note="Solid: every placement so far is goal-stabilizing. Dotted: latched. "
        + error_note(view, "Bars at the right, for the last stage"),
        wide=True,
    )


def error_note(view: View, what: str = "Bars") -> str:
    """Return the description of the error bars: units, their number and method, for each strategy."""
    methods: dict[tuple[str, bool, int], list[str]] = {}
    for strategy, label, _ in view.shown:
        methods.setdefault((view.success(strategy)["method"], *view.units(strategy)), []).append(label)
    parts = []
    for (method, seeds, count), labels in methods.items():
        which = "" if len(methods) == 1 else f" of {listed(labels)}"
        over = f"n = {count:,} {'training seeds' if seeds else 'episodes of one training seed'}"
        if count < FEWEST_FOR_INTERVAL:
            parts.append(f"{what}{which}: none, too few units ({over}).")
        else:
            silent = "" if seeds else ", silent on other seeds"
            parts.append(f"{what}{which}: 95 % intervals over {over}{silent} ({method}).")
    return " ".join(parts)


def unequal_note(view: View) -> str:
    """Return a warning where the strategies did not run the same episodes from the same start poses; else nothing."""
    if "episodes" not in view.tables:
        return ""
    keys = ("eval_seed", "index", "episode_hash")
    ran = [set(view.rows("episodes", strategy).select(keys).rows()) for strategy in view.strategies]
    if all(each == ran[0] for each in ran):
        return ""
    counts = listed([f"{label}: {len(each)}" for label, each in zip(view.labels, ran, strict=True)])
    return f" The strategies ran different episodes ({counts}): see the table of paired episodes."


def outcome_figure(view: View) -> Figure:
    """Return the figure of outcomes (figures 2-1, 2-3): a row for each outcome, a bar for each strategy."""
    import polars as pl

    tables = [view.rows("outcomes", strategy) for strategy in view.strategies]
    seen = {name for table in tables for name in table.filter(pl.col("count") > 0)["outcome"]}
    names = [name for name in tables[0]["outcome"] if name in seen]
    return Figure(
        name="outcomes",
        title="What became of the episodes",
        chart=_share_chart(view, "outcomes", ("outcome",), [(name,) for name in names], map(describe_outcome, names)),
        note="Counted as success: by the benchmark. Did not stay: the first placement that failed or did not last.",
        wide=True,
    )


def mode_figure(view: View, counting: Counting) -> Figure | None:
    """Return the figure of failures by stage and cause, a bar for each strategy; None when nothing failed."""
    labels = mode_labels(view, counting)
    if not labels:
        return None
    stages = {stage.name: describe_stage(stage, unmet=True) for stage in get_task(view.task).stages}
    names = [f"{stages[stage]}: {cause}" for stage, cause in labels]
    forces = [view.rows("episodes", strategy)["force"] for strategy in view.strategies]
    silent = [label for label, force in zip(view.labels, forces, strict=True) if not force.is_finite().any()]
    return Figure(
        name=f"modes-{counting}",
        title=f"Why episodes failed, {'latched' if counting == 'latched' else 'goal-stabilizing'} counting",
        chart=_share_chart(view, "modes", ("stage", "cause"), labels, names, counting=counting),
        note="One cause for each failed episode: what went wrong in the first stage that failed or did not last."
        + (f" No contact forces in the logs, so no collision among the causes: {listed(silent)}." if silent else ""),
        wide=True,
    )


def _share_chart(
    view: View, table: str, keys: tuple[str, ...], order: Sequence[tuple[str, ...]], names: Any, **equal: Any
) -> Any:
    """Return bars of shares of all episodes with their counts, a row for each of `order`, a bar for each strategy."""
    bars = []
    for strategy, label, style in view.shown:
        total = view.success(strategy)["episodes"]
        rows = view.rows(table, strategy, **equal).iter_rows(named=True)
        found = {tuple(row[key] for key in keys): row for row in rows}
        here = [(number, found[key]) for number, key in enumerate(order) if key in found]
        texts = [
            f"{row['count']} of {total} ({wording.share(row['of_all'])})"
            + (f", {wording.share(row['of_failed'])} of the failed" if row["of_failed"] and row["count"] else "")
            for _, row in here
        ]
        shares = np.array([row["of_all"] for _, row in here], dtype=np.float64)
        bars.append(Bars(label, [number for number, _ in here], shares, texts, style))
    return bar_chart(list(names), bars, Axis("share of episodes", percent=True), charts.WIDE)


def kind_figure(view: View) -> Figure | None:
    """Return placements by kind of object, and how many did not stay; None when nothing was placed."""
    tables = [view.rows("kinds", strategy) for strategy in view.strategies]
    kinds = sorted({row for table in tables for row in table.select("kind", "cylinder").rows()})
    if not kinds:
        return None
    bars = []
    for (_, label, style), table in zip(view.shown, tables, strict=True):
        placed, failed = (table[name].to_numpy().astype(np.float64) for name in ("placements", "failures"))
        texts = [_part(bad, n) for bad, n in table.select("failures", "placements").iter_rows()]
        rows = [kinds.index(row) for row in table.select("kind", "cylinder").rows()]
        bars.append(Bars(label, rows, failed, texts, style, placed))
    wide = len(kinds) > 3
    names = [describe_kind(*each) for each in kinds]
    return Figure(
        name="kinds",
        title="Placements that did not stay, by kind of object",
        chart=bar_chart(names, bars, Axis("placements"), charts.WIDE if wide else charts.WIDTH),
        note="Pale: all placements of that kind. Solid: those that did not stay (are not goal-stabilizing).",
        wide=wide,
    )


def shape_figure(view: View) -> Figure | None:
    """Return the share of cylinders among placements and among those that did not stay; None without cylinders."""
    names: list[str] = []
    shares: list[float] = []
    texts: list[str] = []
    for strategy, label, _ in view.shown:
        shapes = by_shape(view, strategy)
        if shapes[0][0]:
            for cylinders, others, what in zip(*shapes, ("placed", "did not stay"), strict=True):
                total = cylinders + others
                names.append(f"{label}: {what} (n = {total})")
                shares.append(cylinders / total if total else 0.0)
                texts.append(_part(cylinders, total))
    if not names:
        return None
    bars = [Bars("cylinders", range(len(names)), np.array(shares), texts, charts.style(1))]
    return Figure(
        name="cylinders",
        title="Cylinders among the placements",
        chart=bar_chart(names, bars, Axis("share of cylinders among the objects", percent=True)),
        note="Cylinders fail more often than other objects where their share is greater among those that did not stay.",
    )


def _part(count: int, total: int) -> str:
    return f"{count:,} of {total:,}" + (f" ({wording.share(count / total)})" if total else "")


def release_figure(view: View, column: str) -> Figure | None:
    """Return the empirical distribution of one of `MEASURES` for each strategy; None without placements."""
    if "placements" not in view.tables:
        return None
    measure = MEASURES[column]
    shown = [
        (label, style, view.rows("placements", strategy)[column].to_numpy())
        for strategy, label, style in view.shown
        if len(view.rows("placements", strategy))
    ]
    if not shown:
        return None
    values = [np.maximum(each, SLOWEST) if measure.log else each for _, _, each in shown]
    low, high = _release_range(values, measure)
    curves = [
        _distribution(label, each, style, low, high) for (label, style, _), each in zip(shown, values, strict=True)
    ]
    sample = wording.sample(list(map(len, values)), "placement")
    marker = measure.marker
    return Figure(
        name=slug("release", column.removeprefix("release_")),
        title=measure.title,
        chart=curve_chart(
            curves,
            Axis(measure.axis, log=measure.log, low=low, high=high),
            Axis(f"share of placements at or below ({sample})", percent=True),
            markers=() if marker is None or not low < marker.at < high else (marker,),
        ),
        note=f"Speeds below {SLOWEST} m/s are drawn there." if measure.log else "",
    )


def _release_range(values: Sequence[FloatArray], measure: Measure) -> tuple[float, float]:
    """Return the ends of the axis of a measure at the release: all values, with a margin where it is linear."""
    low = float(min(map(np.min, values)))
    high = float(max(map(np.max, values)))
    if measure.log:
        return SLOWEST, max(1.0, high)
    margin = 0.03 * (high - low)
    return low - margin, high + margin


def _distribution(label: str, values: FloatArray, style: charts.Style, low: float, high: float) -> Curve:
    """Return the empirical distribution function from low to high, thinned where there are many values."""
    levels = np.linspace(0.0, 1.0, min(len(values), MOST_LEVELS) + 1)
    places = np.quantile(values, levels[1:], method="inverted_cdf")
    return Curve(label, np.array([low, *np.repeat(places, 2), high]), np.repeat(levels, 2), style)
