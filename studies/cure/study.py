"""The study of a cure: its units of work, its frozen table of episodes, and its analysis."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import polars as pl

from perdure.errors import PerdureError
from perdure.policy import load_policy, save_policy
from perdure.runs import Store, Unit
from studies.cure.claims import claims_table, measure_runs
from studies.cure.grid import ARMS, BASE, BASE_SEEDS, PHASES, Arm, cells, variant
from studies.disturbance.grid import TASKS, Condition
from studies.disturbance.study import FRESH, ROWS
from studies.files import include_tables, read_parquet_file, write_csv, write_parquet_file

QUESTION = "Does further training with a longer horizon, under noise, make a policy hold?"
SCALES = {"thesis": Path("results", "cure")}
POLICY = "policy.safetensors"
EPISODES = "episodes.parquet"
BASE_EPISODES = Path("results", "disturbance", FRESH)
"""Episodes of the runs that are continued, evaluated before."""
CELL = ("task", "arm", "condition")
__all__ = ["PHASES", "QUESTION", "SCALES", "analyze", "plan"]


def plan(scale: str, phases: Sequence[int], store: Path) -> list[Unit]:
    """Return the units: training runs, each followed by its evaluations."""
    units = []
    for arm, task in cells(phases):
        run = arm.run(task)
        for seed in arm.seeds:
            training = run.unit(seed)
            units.append(training)
            for _, unit in _evaluations(arm, task, training, store):
                units.append(unit)
    return units


def _evaluations(arm: Arm, task: str, training: Unit, store: Path) -> Iterator[tuple[Condition, Unit]]:
    """Yield the evaluations of a training run: conditions and units."""
    path = str((store / training.key / POLICY).resolve())
    for condition in arm.conditions:
        settings = {
            "disturb": list(condition.disturbs(task)),
            "steps": condition.steps,
            "first": arm.first,
            "starts": arm.starts,
            "world": "",
        }
        name = condition.name.replace(" ", "-")
        key = f"evaluation/{name}/{training.key}"
        config = {"training": dict(training.config), **settings}
        size = 0.5 * condition.steps * arm.starts
        arguments = {"paths": [path], **settings}
        yield condition, Unit(key, config, "studies.disturbance.study:evaluate", arguments, (training.key,), size)


def collect(finished: Store, out: Path) -> list[Path]:
    """Copy the rows of finished evaluations, and the policies, into the results; rows of others stay."""
    parts = []
    written = []
    for arm, task in cells([*PHASES]):
        run = arm.run(task)
        for seed in arm.seeds:
            training = run.unit(seed)
            if not finished.done(training.key):
                continue
            policy = load_policy(finished.get(training.key) / POLICY).without_critic()
            written.append(
                save_policy(policy, out / "policies" / task / variant(arm.name, task) / f"seed-{seed}.safetensors")
            )
            for condition, unit in _evaluations(arm, task, training, finished.root):
                if finished.done(unit.key):
                    rows = read_parquet_file(finished.get(unit.key) / ROWS)
                    parts.append(rows.with_columns(arm=pl.lit(arm.name), condition=pl.lit(condition.name)))
    if parts:
        rows = pl.concat(parts, how="diagonal")
        if (out / EPISODES).is_file():
            known = read_parquet_file(out / EPISODES)
            others = known.join(rows, [*CELL, "train_seed"], "anti")
            rows = pl.concat([rows, others], how="diagonal")
        write_parquet_file(out / EPISODES, rows.sort(*CELL, "train_seed", "eval_seed"))
    return written


def base_episodes(path: Path = BASE_EPISODES) -> pl.DataFrame:
    """Return the episodes of the committed runs that are continued."""
    rows = read_parquet_file(path)
    mine = pl.col("train_seed").is_in(BASE_SEEDS) & (pl.col("method").str.split("@").list.first() == BASE)
    return rows.filter(mine).drop("method").with_columns(arm=pl.lit(BASE))


def analyze(scale: str, out: Path) -> list[Path]:
    """Write the tables from the frozen table of episodes, and those of the page `README.md`.

    Finished units of the study's own store, OUT/runs, are collected first.

    Raises:
        PerdureError: There are no results.
    """
    written = []
    if (out / "runs").is_dir():
        written += collect(Store(out / "runs"), out)
    if not (out / EPISODES).is_file():
        raise PerdureError(f"there are no results of the study cure in {out}; run it first")
    episodes = pl.concat([read_parquet_file(out / EPISODES), base_episodes()], how="diagonal")
    tables = {"claims": claims_table(episodes), "runs": measure_runs(episodes), "arms": arms_table(episodes)}
    written += [write_csv(out / "tables" / f"{name}.csv", frame) for name, frame in tables.items()]
    page = out / "README.md"
    if page.is_file():
        written.append(include_tables(page, {"arms": _texts(tables["arms"])}))
    return written


def arms_table(episodes: pl.DataFrame) -> pl.DataFrame:
    """Return the means over training runs of each kind of run, task and condition."""
    words = {BASE: "discounted PPO, before", **{arm.name: arm.words for arm in ARMS}}
    measures = ("work", "score", "holding share", "speed")
    runs = measure_runs(episodes)
    means = runs.group_by("task", "condition", "arm").agg(
        pl.len().alias("runs"), *(pl.col(name).mean() for name in measures)
    )
    failed = pl.col("failed_step") < pl.col("test_horizon")
    failures = episodes.group_by("task", "condition", "arm").agg(
        failed.sum().alias("failures"), pl.len().alias("episodes"), pl.col("failed_step").sum().alias("steps that work")
    )
    table = means.join(failures, ["task", "condition", "arm"]).sort("task", "condition", "arm")
    return table.with_columns(words=pl.col("arm").replace_strict(words))


def _texts(arms: pl.DataFrame) -> pl.DataFrame:
    """Return the table of the page: under `standard-1`."""
    tasks = {task: place for place, task in enumerate(TASKS)}
    order = {name: place for place, name in enumerate((BASE, *dict.fromkeys(arm.name for arm in ARMS)))}
    shown = arms.filter(condition="standard-1").sort(
        pl.col("task").replace_strict(tasks, default=len(tasks)), pl.col("arm").replace_strict(order)
    )
    return shown.select(
        pl.col("task"),
        pl.col("words").alias("training"),
        pl.col("runs").cast(pl.String),
        pl.Series("work", [f"{each:.2f}" for each in shown["work"]]),
        pl.format("{} of {}", pl.col("episodes") - pl.col("failures"), "episodes").alias("episodes without failure"),
        pl.Series("speed", [f"{each:.2f}" for each in shown["speed"]]),
    )
