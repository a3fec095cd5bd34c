"""Analyze the results: write tables, figures, the claim table and the page."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import polars as pl

from perdure.report.render import Figure, Format, save
from perdure.runs import write_atomic
from perdure.studies.files import write_csv
from perdure.studies.horizon.across_tasks import gain_table
from perdure.studies.horizon.claim import Claim
from perdure.studies.horizon.claim_table import claims_frame, claims_text
from perdure.studies.horizon.decide import decide_claims
from perdure.studies.horizon.figure_curves import clock_figures, survival_figures, training_horizon_figures
from perdure.studies.horizon.figure_gain import gain_figure
from perdure.studies.horizon.figure_mechanism import mechanism_figures
from perdure.studies.horizon.figure_returns import bias_figure, return_figures
from perdure.studies.horizon.figure_sweep import sweep_figures
from perdure.studies.horizon.figure_training import training_figures
from perdure.studies.horizon.figure_verdicts import verdict_figures
from perdure.studies.horizon.grid import Grid
from perdure.studies.horizon.page import write_page
from perdure.studies.horizon.results import Results, read_results
from perdure.studies.horizon.summaries import choice_table, condition_table, rule_table
from perdure.studies.horizon.tables import failure_places

FORMATS: tuple[Format, ...] = ("png", "svg")


def analyze(grid: Grid, out: Path) -> list[Path]:
    """Write everything under `out` again and return the files, the page last. The same tables give the same bytes."""
    results = read_results(grid, out)
    families = [decide_claims(claims_of(grid, family), results) for family in grid.families]
    decided = [each for family in families for each in family]
    frames = {name: frame for name, frame in _tables(results) if not frame.is_empty()}
    if decided:
        frames["claims"] = claims_frame(decided)
    written = [write_csv(out / "tables" / f"{name}.csv", frame) for name, frame in frames.items()]
    figures = list(make_figures(results))
    save(figures, out / "figures", FORMATS)
    written += [out / "figures" / f"{figure.name}.{kind}" for figure in figures for kind in FORMATS]
    written.append(write_atomic(out / "claims.md", claims_text(families)))
    return [*written, write_page(out / "README.md", results, families, figures)]


def claims_of(grid: Grid, claims: Sequence[Claim]) -> Sequence[Claim]:
    """Return the claims about settings of this grid."""
    settings = set(grid.settings)
    return [claim for claim in claims if settings & set(claim.tasks)]


def _tables(results: Results) -> Iterator[tuple[str, pl.DataFrame]]:
    yield "training", results.training
    yield "runs", results.runs
    yield "validation", results.validation_runs
    yield "conditions", condition_table(results)
    yield "gain", gain_table(results)
    yield "choice", choice_table(results)
    yield "rules", rule_table(results)
    yield "mechanism", results.mechanism
    yield "failure-places", failure_places(results.test)


def make_figures(results: Results) -> Iterator[Figure]:
    """Draw every figure for which there are tables."""
    choices = choice_table(results)
    yield from gain_figure(results)
    yield from training_horizon_figures(results)
    yield from return_figures(results)
    yield from training_figures(results)
    yield from sweep_figures(results)
    yield from clock_figures(results)
    yield from survival_figures(results)
    yield from verdict_figures(results)
    if not choices.is_empty():
        yield from bias_figure(choices.filter((pl.col("kind") == "constant") & (pl.col("method") == "geometric")))
    yield from mechanism_figures(results)
