"""The analysis as plain text: one block per task, split and strategy."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from perdure.home.evaluate.outcomes.labels import COUNTINGS
from perdure.home.evaluate.outcomes.placements import GROUP

if TYPE_CHECKING:
    import polars as pl

    from perdure.home.evaluate.outcomes.analysis import Analysis


_SHARES, _SHARE_COLUMNS = ("count", "of all", "of failed"), ("count", "of_all", "of_failed")


def summary_text(analysis: Analysis) -> str:
    """Return all tables of an analysis but those with one row per episode or placement."""
    groups = analysis.episodes.select(GROUP).unique(maintain_order=True).rows()
    return "\n\n".join(_block(analysis, group) for group in groups)


def _block(analysis: Analysis, group: tuple[str, ...]) -> str:
    import polars as pl

    def part(table: pl.DataFrame) -> pl.DataFrame:
        return table.filter(*(pl.col(name) == value for name, value in zip(GROUP, group, strict=True)))

    episodes, stages = part(analysis.episodes), part(analysis.stages)
    settled = episodes["settle_seconds"].to_list()
    head = (
        f"{group[0]} {group[1]}, {group[2]}: {len(episodes)} episodes, runs: {stages['runs'][0]}, "
        f"then {min(settled):.1f} to {max(settled):.1f} s of settling, {sum(episodes['diverged'].to_list())} diverged"
    )
    intervals = f"95 % intervals over {stages['units'][0]}: {stages['method'][0]}"
    parts = [head, f"success per stage ({intervals})", _table(_stage_rows(stages))]
    parts += ["outcomes", _table(_rows(part(analysis.outcomes), ("outcome", *_SHARES), ("outcome", *_SHARE_COLUMNS)))]
    for counting in COUNTINGS:
        modes = part(analysis.modes).filter(pl.col("counting") == counting)
        if len(modes):
            parts += [
                f"failure modes, {counting}",
                _table(_rows(modes, ("stage", "cause", *_SHARES), ("stage", "cause", *_SHARE_COLUMNS))),
            ]
    if len(part(analysis.placements)):
        counts, columns = ("placements", "not stable", "rate"), ("placements", "failures", "rate")
        headings = ("shape", *counts, "of placements", "of not stable")
        shapes = _rows(part(analysis.shapes), headings, ("cylinder", *columns, "of_placements", "of_failures"))
        kinds = _rows(part(analysis.kinds), ("kind", *counts), ("kind", *columns))
        parts += ["placements", _table(shapes), _table(kinds)]
    return "\n".join(parts)


def _stage_rows(stages: pl.DataFrame) -> list[Sequence[str]]:
    rows: list[Sequence[str]] = [("stage", *COUNTINGS)]
    by_counting = [stages.filter(counting=counting) for counting in COUNTINGS]
    for k, name in enumerate(by_counting[0]["stage"]):
        rows.append((name, *(interval_text(table.row(k, named=True)) for table in by_counting)))
    return rows


def interval_text(row: dict[str, float]) -> str:
    """Return mean, standard error and 95 % interval of a row of `Analysis.stages`: "50.0 +- 14.4 % [12.3, 87.7]"."""
    error = "" if math.isnan(row["standard_error"]) else f" +- {100 * row['standard_error']:.1f}"
    bounds = "" if math.isnan(row["lower"]) else f" [{100 * row['lower']:.1f}, {100 * row['upper']:.1f}]"
    return f"{100 * row['mean']:.1f}{error} %{bounds}"


def _rows(table: pl.DataFrame, headings: Sequence[str], columns: Sequence[str]) -> list[Sequence[str]]:
    """Return columns as text under headings: shares (real numbers) in percent, nothing for null."""
    return [headings, *(tuple(map(_cell, row)) for row in table.select(columns).iter_rows())]


def _cell(value: object) -> str:
    if isinstance(value, bool):
        return "cylinder" if value else "other"
    if isinstance(value, float):
        return f"{100 * value:.1f} %"
    return "" if value is None else str(value)


def _table(rows: Sequence[Sequence[str]]) -> str:
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    cells = [(row[0].ljust(widths[0]), *map(str.rjust, row[1:], widths[1:])) for row in rows]
    return "\n".join(f"  {'  '.join(row).rstrip()}" for row in cells)
