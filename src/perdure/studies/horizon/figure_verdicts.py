"""Shares of verdicts by setting and method, as stacked bars."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import polars as pl

from perdure.report import theme, wording
from perdure.report.axes import row_size
from perdure.report.render import Figure, slug
from perdure.studies.horizon import words
from perdure.studies.horizon.claim import Condition
from perdure.studies.horizon.results import Results
from perdure.studies.horizon.tables import VERDICTS

if TYPE_CHECKING:
    import altair as alt

SHOWN = (
    Condition("ppo"),
    Condition("ppo-undiscounted"),
    Condition("ppo-average-reward"),
    Condition("random-horizon"),
    Condition("linear", "constant:500"),
    Condition("linear-random", "constant:500"),
    Condition("geometric", "constant:500"),
    Condition("geometric", "chosen"),
    Condition("geometric", "countdown"),
    Condition("geometric-fixed", "chosen"),
)

COLORS = {"holds": 2, "decays": 4, "fails silently": 3, "falls": 1, "diverges": 6, "never worked": 7, "cannot tell": 5}
"""Verdict to its place among the colors of `theme.style`."""


def verdict_figures(results: Results) -> Iterator[Figure]:
    """Return one figure for each setting: what became of the episodes of each method."""
    for setting in results.grid.settings:
        shares = verdict_shares(results, setting)
        if shares.is_empty():
            continue
        counts = wording.sample(shares["episodes"].unique().to_list(), "episode")
        note = f"Share of the test episodes of each method; {counts}. Training runs count alike."
        chart = _stacked(shares)
        yield Figure(slug("verdicts", setting), "What became of the episodes", chart, note, words.setting(setting))


def verdict_shares(results: Results, setting: str) -> pl.DataFrame:
    """Return the share of each verdict: "method", "verdict", "share", "episodes"."""
    rows: list[dict[str, Any]] = []
    for condition in SHOWN:
        row = results.grid.row(setting, condition.method)
        if row is None or row.key not in results.test:
            continue
        clocks = results.clocks(row, condition.clock)
        lanes = results.test[row.key].lanes
        chosen = lanes.filter(
            pl.struct("train_seed", "clock").is_in([{"train_seed": s, "clock": c} for s, c in clocks.items()])
        )
        for verdict in VERDICTS if len(chosen) else ():
            by_run = (
                chosen.group_by("train_seed")
                .agg((pl.col("verdict") == verdict).mean().alias("share"))
                .sort("train_seed")
            )
            share = float(by_run["share"].mean() or 0.0)  # type: ignore[arg-type]
            rows.append(
                {"method": words.condition(condition), "verdict": verdict, "share": share, "episodes": len(chosen)}
            )
    return pl.DataFrame(rows)


def _stacked(shares: pl.DataFrame) -> alt.LayerChart:
    import altair as alt

    names = shares["method"].unique(maintain_order=True).to_list()
    shown = [verdict for verdict in VERDICTS if shares.filter(pl.col("verdict") == verdict)["share"].sum() > 0]
    colors = [theme.style(COLORS[verdict]).color for verdict in shown]
    rows = [
        {**row, "share": float(f"{row['share']:.6g}"), "order": VERDICTS.index(row["verdict"])}
        for row in shares.iter_rows(named=True)
        if row["share"] > 0
    ]
    plot, height = row_size(names, 1, theme.WIDTH)
    x_axis = alt.Axis(labelExpr="format(100 * datum.value, '~g') + ' %'", grid=False)
    bars = (
        alt.Chart(alt.InlineData(values=rows))
        .mark_bar()
        .encode(
            alt.Y("method:N", title=None, scale=alt.Scale(domain=names, paddingInner=0.3)),
            alt.X("share:Q", title="share of episodes", scale=alt.Scale(domain=[0.0, 1.0]), axis=x_axis),
            alt.Color("verdict:N", title=None, scale=alt.Scale(domain=shown, range=colors)),
            alt.Order("order:Q"),
            [alt.Tooltip("verdict:N"), alt.Tooltip("share:Q", format=".1%")],
        )
    )
    return alt.LayerChart(layer=[bars], width=plot, height=height)
