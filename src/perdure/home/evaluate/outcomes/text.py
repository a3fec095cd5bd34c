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
    parts += ["outcomes", _table(_outcome_rows(part(analysis.outcomes)))]
    for counting in COUNTINGS:
        modes = part(analysis.modes).filter(pl.col("counting") == counting)
        if len(modes):
            parts += [f"failure modes, {counting}", _table(_mode_rows(modes))]
    if len(part(analysis.placements)):
        parts += ["placements", _table(_shape_rows(part(analysis.shapes))), _table(_kind_rows(part(analysis.kinds)))]
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


def _outcome_rows(outcomes: pl.DataFrame) -> list[Sequence[str]]:
    rows = outcomes.select("outcome", "count", "of_all", "of_failed").iter_rows()
    return [
        ("outcome", "count", "of all", "of failed"),
        *((name, str(count), _percent(a), _percent(b)) for name, count, a, b in rows),
    ]


def _mode_rows(modes: pl.DataFrame) -> list[Sequence[str]]:
    rows = modes.select("stage", "cause", "count", "of_all", "of_failed").iter_rows()
    return [
        ("stage", "cause", "count", "of all", "of failed"),
        *((stage, word, str(count), _percent(a), _percent(b)) for stage, word, count, a, b in rows),
    ]


def _shape_rows(shapes: pl.DataFrame) -> list[Sequence[str]]:
    rows = shapes.select("cylinder", "placements", "failures", "rate", "of_placements", "of_failures").iter_rows()
    return [
        ("shape", "placements", "not stable", "rate", "of placements", "of not stable"),
        *(("cylinder" if c else "other", str(n), str(bad), *map(_percent, shares)) for c, n, bad, *shares in rows),
    ]


def _kind_rows(kinds: pl.DataFrame) -> list[Sequence[str]]:
    rows = kinds.select("kind", "placements", "failures", "rate").iter_rows()
    return [
        ("kind", "placements", "not stable", "rate"),
        *((kind, str(count), str(bad), _percent(rate)) for kind, count, bad, rate in rows),
    ]


def _percent(share: float | None) -> str:
    return "" if share is None else f"{100 * share:.1f} %"


def _table(rows: Sequence[Sequence[str]]) -> str:
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    cells = [(row[0].ljust(widths[0]), *map(str.rjust, row[1:], widths[1:])) for row in rows]
    return "\n".join(f"  {'  '.join(row).rstrip()}" for row in cells)
