"""The study of disturbances: its units of work, its frozen table of episodes, and its analysis."""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path

import polars as pl

from perdure.errors import PerdureError
from perdure.evaluate import Execution, Extrapolation, evaluate_files
from perdure.policy import load_policy, save_policy
from perdure.report.charts import save
from perdure.runs import Store, Unit, Work, file_digest
from perdure.runs.progress import total_share
from studies.disturbance.claims import claims_table, measure_runs, speed_while_working
from studies.disturbance.cure import cure_table
from studies.disturbance.grid import FIRST_START, GRIDS, STARTS, Condition, Subject, subjects
from studies.disturbance.sensitivity import threshold_table, work_table
from studies.disturbance.tables import all_tables, draw_figures, method_table, page_tables
from studies.files import include_tables, read_parquet_file, write_csv, write_parquet_file

QUESTION = "Do policies that hold when calm hold under disturbances, and does the verdict foresee new ones?"
SCALES = {"thesis": Path("results", "disturbance")}
EPISODES = "episodes.parquet"
FRESH = "registered.parquet"
PILOTS = "pilots.parquet"
ROWS = "rows.parquet"
CELL = ("task", "method", "condition")
PHASES = {1: EPISODES, 2: FRESH, 3: PILOTS}
"""Number to the frozen table of its episodes."""
COLUMNS = (
    "task",
    "train_seed",
    "clock",
    "eval_seed",
    "disturbance",
    "test_horizon",
    "end_reason",
    "end_step",
    "outcome",
    "failed_step",
    "end_score_vs_training",
    "idle_rate",
    "training_rate",
    "published_rate",
    "policy_state",
    "return",
)
"""Columns of the evaluation table that are kept, for each episode once."""


def plan(scale: str, phases: Sequence[int], store: Path) -> list[Unit]:
    """Return the units: all committed policies (1), the runs of the registered claims (2), pilots of a cure (3)."""
    units = []
    for phase in phases:
        units += [_unit(*each) for each in _cells(phase)]
    return units


def _cells(phase: int) -> Iterator[tuple[str, Condition, Subject]]:
    """Yield the key of each cell of a phase's grid, and the cell."""
    conditions, robots, seeds = GRIDS[phase]
    folder = ""
    if phase != 1:
        folder = f"{Path(PHASES[phase]).stem}/"
    for condition, subject in product(conditions, list(subjects(robots, seeds))):
        if not condition.world or condition.world.startswith(f"gymnasium:{subject.task[:-1]}"):
            name = condition.name.replace(" ", "-")
            yield f"{folder}{name}/{subject.task}/{subject.variant}", condition, subject


def _unit(key: str, condition: Condition, subject: Subject) -> Unit:
    settings = {
        "disturb": list(condition.disturbs(subject.task)),
        "steps": condition.steps,
        "first": FIRST_START,
        "starts": STARTS,
        "world": condition.world,
    }
    config = {"policies": [file_digest(path) for path in subject.files], **settings}
    paths = [str(path.resolve()) for path in subject.files]
    size = float(len(paths) * condition.steps)
    return Unit(key, config, f"{__name__}:evaluate", {"paths": paths, **settings}, size=size)


def evaluate(
    work: Work, *, paths: Sequence[str], disturb: Sequence[str], steps: int, first: int, starts: int, world: str
) -> None:
    """Evaluate policies in this process and leave a row for each episode; the function of the units."""
    store = work.folder / "episodes"
    files = [Path(path) for path in paths]
    if world:
        files = [_moved(path, world, work.folder / path.name) for path in files]
    evaluation = Extrapolation(
        tuple(files), steps, ("constant:500",), starts, first_eval_seed=first, disturb=tuple(disturb)
    )
    result = evaluate_files(
        evaluation, Execution(store, on="here", observe=lambda status: work.report(total_share(status), 1.0))
    )
    rows = result.final.select(COLUMNS).with_columns(speed=speed_while_working(result.frame))
    write_parquet_file(work.folder / ROWS, rows)
    shutil.rmtree(store, ignore_errors=True)


def _moved(path: Path, world: str, to: Path) -> Path:
    """Write a policy that acts in another world of its robot."""
    policy = load_policy(path)
    return save_policy(replace(policy, task=replace(policy.task, name=world)), to)


def collect(finished: Store, phase: int, frozen: Path) -> None:
    """Copy the rows of a phase's finished units into a frozen table; rows of others stay."""
    parts = []
    for key, condition, subject in _cells(phase):
        if finished.done(key):
            rows = read_parquet_file(finished.get(key) / ROWS)
            parts.append(
                rows.with_columns(
                    task=pl.lit(subject.task), method=pl.lit(subject.variant), condition=pl.lit(condition.name)
                )
            )
    if parts:
        rows = pl.concat(parts, how="diagonal")
        if frozen.is_file():
            others = read_parquet_file(frozen).join(rows, CELL, "anti")
            rows = pl.concat([rows, others], how="diagonal")
        write_parquet_file(frozen, rows.sort(*CELL, "train_seed", "eval_seed"))


def analyze(scale: str, out: Path) -> list[Path]:
    """Write tables and figures from the frozen table, and the tables of the page `README.md`.

    Finished units of the study's own store, OUT/runs, are collected first.

    Raises:
        PerdureError: There are no results.
    """
    if (out / "runs").is_dir():
        for phase, name in PHASES.items():
            collect(Store(out / "runs"), phase, out / name)
    if not (out / EPISODES).is_file():
        raise PerdureError(f"there are no results of the study disturbance in {out}; run it first")
    tables = all_tables(read_parquet_file(out / EPISODES))
    tables["cure"] = cure_table(read_parquet_file(out / EPISODES), "0 to 9")
    fresh = None
    if (out / FRESH).is_file():
        fresh = read_parquet_file(out / FRESH)
        tables["claims"] = claims_table(fresh)
        tables["methods"] = method_table(measure_runs(fresh))
        tables["thresholds"] = threshold_table(fresh)
        tables["work"] = work_table(fresh)
        cures = [tables["cure"], cure_table(fresh, "10 to 19")]
        if (out / PILOTS).is_file():
            cures.append(cure_table(read_parquet_file(out / PILOTS), "20 to 22", fresh))
        tables["cure"] = pl.concat(cures, how="diagonal")
    written = [write_csv(out / "tables" / f"{name}.csv", frame) for name, frame in tables.items()]
    written += save(draw_figures(tables, fresh), out / "figures", ("svg",))
    page = out / "README.md"
    if page.is_file():
        written.append(include_tables(page, page_tables(tables)))
    return written
