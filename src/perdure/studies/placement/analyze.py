"""Analyze the results: write tables, figures and the page from logs, if any, and the committed tables."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from perdure.report.render import Figure, Format, save
from perdure.studies.files import write_csv
from perdure.studies.placement.figure_cylinders import cylinder_figures
from perdure.studies.placement.figure_outcomes import outcome_figures
from perdure.studies.placement.figure_stages import stage_figures
from perdure.studies.placement.figure_strategies import strategy_figures
from perdure.studies.placement.flat_tables import difference_frame, success_frame
from perdure.studies.placement.grid import Grid
from perdure.studies.placement.page import write_page
from perdure.studies.placement.release_speed import speed_figures
from perdure.studies.placement.tables import HAND_OVER, NOISE, SPEEDS, STRATEGIES, Tables, update_tables

FORMATS: tuple[Format, ...] = ("png", "svg")


def analyze(grid: Grid, out: Path) -> list[Path]:
    """Write everything under `out` again and return the files, the page last. The same tables give the same bytes."""
    tables = update_tables(grid, out)
    written = [tables.results.write(out / STRATEGIES)]
    kept = {SPEEDS: tables.speeds, HAND_OVER: tables.hand_over, NOISE: tables.noise}
    flat = {
        Path("tables", "success.csv"): success_frame(tables.results),
        Path("tables", "differences.csv"): difference_frame(tables.results),
    }
    written += [write_csv(out / path, frame) for path, frame in {**kept, **flat}.items() if not frame.is_empty()]
    figures = list(make_figures(tables))
    save(figures, out / "figures", FORMATS)
    written += [out / "figures" / f"{figure.name}.{kind}" for figure in figures for kind in FORMATS]
    return [*written, write_page(out / "README.md", grid, tables, figures)]


def make_figures(tables: Tables) -> Iterator[Figure]:
    """Draw every figure for which there are rows."""
    yield from outcome_figures(tables.results)
    yield from stage_figures(tables.results)
    yield from cylinder_figures(tables.results)
    yield from strategy_figures(tables.results)
    yield from speed_figures(tables.speeds)
