"""Figures of success in both ways of counting: the whole task, and stage by stage (figure 2-2)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from perdure.home.evaluate.outcomes import COUNTINGS, Counting
from perdure.home.evaluate.page import words
from perdure.home.evaluate.page.comparison import Comparison, listed
from perdure.report import theme, wording
from perdure.report.axes import Axis
from perdure.report.curves import Curve, curve_chart
from perdure.report.render import Figure
from perdure.report.rows import Points, point_chart
from perdure.report.statistics import FEWEST_FOR_INTERVAL

WORDS: dict[Counting, str] = {"latched": "latched (benchmark)", "stabilizing": "goal-stabilizing (thesis)"}


def final_figure(comparison: Comparison) -> Figure:
    """Return the success of the whole task: a row for each strategy, a point for each way of counting."""

    def points(counting: Counting) -> Points:
        rows = [comparison.final(strategy, counting) for strategy in comparison.strategies]
        drawn = np.array([comparison.has_intervals(strategy) for strategy in comparison.strategies])
        lower, upper = (np.where(drawn, [row[bound] for row in rows], np.nan) for bound in ("lower", "upper"))
        latched = counting == "latched"
        return Points(
            label=WORDS[counting],
            rows=range(len(comparison.strategies)),
            x=np.array([row["mean"] for row in rows]),
            style=theme.Style(theme.FADED, shape="square") if latched else theme.style(0),
            lower=lower,
            upper=upper,
            members=None if latched else [_by_seed(comparison, strategy) for strategy in comparison.strategies],
        )

    pairs = zip(comparison.strategies, comparison.labels, strict=True)
    rings = (
        "Rings: each training seed. "
        if any(_by_seed(comparison, strategy) for strategy in comparison.strategies)
        else ""
    )
    return Figure(
        name="success",
        title="Success of the whole task",
        chart=point_chart(
            [f"{label} (n = {len(comparison.episodes[strategy]):,})" for strategy, label in pairs],
            [points(counting) for counting in COUNTINGS],
            Axis("share of n episodes", percent=True),
        ),
        note="Latched: a stage counts once its conditions hold, whatever follows. Goal-stabilizing: objects also stay. "
        + rings
        + error_note(comparison)
        + unequal_note(comparison),
    )


def stage_figure(comparison: Comparison) -> Figure:
    """Return the success per stage: a curve for each strategy and way of counting."""
    names = words.stages(comparison.home_task)
    curves = []
    for strategy, label, style in zip(comparison.strategies, comparison.labels, comparison.styles, strict=True):
        for counting in reversed(COUNTINGS):
            table = comparison.stages[strategy].filter(counting=counting)
            lasting = counting == "stabilizing"
            shown = lasting and comparison.has_intervals(strategy)
            curves.append(
                Curve(
                    label=label if lasting else f"{label}: latched",
                    x=np.arange(len(names), dtype=np.float64),
                    y=table["mean"].to_numpy(),
                    style=replace(style, dash=theme.SOLID if lasting else (2, 3)),
                    lower=table["lower"].to_numpy() if shown else None,
                    upper=table["upper"].to_numpy() if shown else None,
                    marked=lasting,
                    named=lasting,
                    intervals="last",
                )
            )
    return Figure(
        name="stages",
        title="Success per stage",
        chart=curve_chart(
            curves,
            Axis("stage of the task, in order", names=names),
            Axis(f"share of episodes that reached it ({_episodes(comparison)})", percent=True),
            width=theme.WIDE,
        ),
        note="Solid: every placement so far is goal-stabilizing. Dotted: latched. "
        + error_note(comparison, "Bars at the right, for the last stage"),
        wide=True,
    )


def _episodes(comparison: Comparison) -> str:
    return wording.sample([len(comparison.episodes[strategy]) for strategy in comparison.strategies], "episode")


def error_note(comparison: Comparison, what: str = "Bars") -> str:
    """Return the description of the error bars: units, their number and method, for each strategy."""
    methods: dict[tuple[str, bool, int], list[str]] = {}
    for strategy, label in zip(comparison.strategies, comparison.labels, strict=True):
        method = str(comparison.final(strategy, "latched")["method"])
        methods.setdefault((method, *comparison.units(strategy)), []).append(label)
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


def unequal_note(comparison: Comparison) -> str:
    """Return a warning where the strategies did not run the same episodes from the same start poses; else nothing."""
    ran = [
        set(comparison.episodes[strategy].select("eval_seed", "index", "episode_hash").rows())
        for strategy in comparison.strategies
    ]
    if all(each == ran[0] for each in ran):
        return ""
    counts = listed([f"{label}: {len(each)}" for label, each in zip(comparison.labels, ran, strict=True)])
    return f" The strategies ran different episodes ({counts}): see the table of paired episodes."


def _by_seed(comparison: Comparison, strategy: str) -> list[float]:
    """Return the goal-stabilizing success of every training seed; nothing where there is one."""
    parts = comparison.episodes[strategy].partition_by("train_seed")
    return [float(part["stabilizing"].to_numpy().mean()) for part in parts] if len(parts) > 1 else []
