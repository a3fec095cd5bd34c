"""The study of disturbances: its units of work, its frozen table of episodes, and its analysis."""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path

import polars as pl

from perdure.errors import PerdureError
from perdure.evaluate import Extrapolation, evaluate_files
from perdure.policy import load_policy, save_policy
from perdure.report.charts import save
from perdure.runs import Store, Unit, Work, file_digest, write_atomic
from perdure.runs.progress import total_share
from studies.disturbance.grid import CONDITIONS, FIRST_START, STARTS, Condition, Subject, subjects
from studies.disturbance.tables import all_tables, draw_figures, page_tables
from studies.files import include_tables, parquet_bytes, read_parquet_file, write_csv

QUESTION = "Do policies that hold when calm hold under disturbances, and does the verdict foresee new ones?"
SCALES = {"thesis": Path("results", "disturbance")}
PHASES = (1,)
EPISODES, ROWS = "episodes.parquet", "rows.parquet"
COLUMNS = (
    *("task", "train_seed", "clock", "eval_seed", "disturbance", "test_horizon", "end_reason", "end_step", "outcome"),
    *("failed_step", "end_score_vs_training", "idle_rate", "training_rate", "published_rate", "policy_state", "return"),
)
"""Columns of the evaluation table that are kept, for each episode once."""


def plan(scale: str, phases: Sequence[int], store: Path) -> list[Unit]:
    """Return the units: every subject under every condition."""
    return list(_units())


def _units() -> Iterator[Unit]:
    for condition in CONDITIONS:
        for subject in subjects():
            if condition.world and not condition.world.startswith(f"gymnasium:{subject.task[:-1]}"):
                continue
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
            yield Unit(
                _key(condition, subject), config, f"{__name__}:evaluate", {"paths": paths, **settings}, size=size
            )


def evaluate(
    work: Work, *, paths: Sequence[str], disturb: Sequence[str], steps: int, first: int, starts: int, world: str
) -> None:
    """Evaluate policies in this process and leave a row for each episode; the function of the units."""
    store, files = work.folder / "episodes", [Path(path) for path in paths]
    if world:
        files = [_moved(path, world, work.folder / path.name) for path in files]
    evaluation = Extrapolation(
        tuple(files),
        steps,
        ("constant:500",),
        starts,
        first_eval_seed=first,
        disturb=tuple(disturb),
    )
    result = evaluate_files(evaluation, store, on="here", observe=lambda status: work.report(total_share(status), 1.0))
    write_atomic(work.folder / ROWS, parquet_bytes(result.final().select(COLUMNS)))
    shutil.rmtree(store, ignore_errors=True)


def _moved(path: Path, world: str, to: Path) -> Path:
    """Write a policy that acts in another world of its robot."""
    policy = load_policy(path)
    return save_policy(replace(policy, task=replace(policy.task, name=world)), to)


def collect(store: Path, out: Path) -> Path:
    """Copy the rows of finished units into the frozen table; rows of others stay.

    Raises:
        PerdureError: No unit is finished, and there is no table.
    """
    finished, parts, frozen = Store(store), list[pl.DataFrame](), out / EPISODES
    for condition, subject in product(CONDITIONS, subjects()):
        key = _key(condition, subject)
        if finished.done(key):
            rows = read_parquet_file(finished.get(key) / ROWS)
            named = {"task": subject.task, "method": subject.variant, "condition": condition.name}
            parts.append(rows.with_columns(**{name: pl.lit(value) for name, value in named.items()}))
    if frozen.is_file():
        old = read_parquet_file(frozen)
        new = pl.concat(parts).select("task", "method", "condition").unique() if parts else old.clear()
        parts.append(old.join(new, ("task", "method", "condition"), "anti"))
    if not parts:
        raise PerdureError(f"there are no results of the study disturbance in {out}; run it first")
    order = ("task", "method", "condition", "train_seed", "eval_seed")
    return write_atomic(frozen, parquet_bytes(pl.concat(parts, how="diagonal").sort(order)))


def _key(condition: Condition, subject: Subject) -> str:
    return f"{condition.name.replace(' ', '-')}/{subject.task}/{subject.variant}"


def analyze(scale: str, out: Path) -> list[Path]:
    """Write tables and figures from the frozen table, and the tables of the page `README.md`.

    Finished units of the study's own store, OUT/runs, are collected first.

    Raises:
        PerdureError: There are no results.
    """
    if (out / "runs").is_dir():
        collect(out / "runs", out)
    if not (out / EPISODES).is_file():
        raise PerdureError(f"there are no results of the study disturbance in {out}; run it first")
    tables = all_tables(read_parquet_file(out / EPISODES))
    written = [write_csv(out / "tables" / f"{name}.csv", frame) for name, frame in tables.items()]
    figures = list(draw_figures(tables))
    save(figures, out / "figures", ("svg",))
    written += [out / "figures" / f"{figure.name}.svg" for figure in figures]
    page = out / "README.md"
    return [*written, include_tables(page, page_tables(tables))] if page.is_file() else written
