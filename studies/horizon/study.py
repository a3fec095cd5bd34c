"""The study of chapter 3: its units of work, its frozen tables, and its analysis.

Units (`perdure.runs`) work in a store: training runs, evaluations, short rollouts. `collect` copies what is finished
into the frozen tables (`results.py`) and policies without critics; the analysis reads only these.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import polars as pl

from perdure.envs import task_spec
from perdure.errors import PerdureError
from perdure.evaluate import Execution, Extrapolation, evaluate_files
from perdure.evaluate.options import OWN_CLOCK
from perdure.evaluate.table import TABLE_FILE
from perdure.horizon import Constant
from perdure.learn import PPOConfig, method_config
from perdure.policy import load_policy, save_policy
from perdure.report import read_table
from perdure.report.charts import save
from perdure.runs import Store, Unit, Work
from perdure.runs.progress import total_share
from studies.files import include_tables, read_parquet_file, write_csv
from studies.horizon.grid import GRIDS, NOISY_START, PHASES, SWEPT, Grid, Row, make_grid
from studies.horizon.results import (
    CLOCKS,
    EPISODES,
    LEARNING,
    MECHANISMS,
    TABLES,
    TEST,
    FrozenTable,
    freeze_episodes,
    freeze_learning,
    read_results,
)
from studies.horizon.rollouts import RESULT, ROLLOUTS

if TYPE_CHECKING:
    from perdure.learn.run import TrainRun

QUESTION = "Does a policy trained in finite episodes hold for 100,000 steps, and does a constant time-to-go help?"
SCALES = {"smoke": None, "laptop": None, "thesis": Path("results", "horizon")}
"""Name of a scale to the folder of its results, if they are kept in the repository."""
__all__ = ["PHASES", "QUESTION", "SCALES", "analyze", "collect", "plan"]
POLICY = "policy.safetensors"
EVALUATION = "evaluation"
MECHANISM = "mechanism"
RULES = "clocks"
STAGES = (EVALUATION, MECHANISM, RULES)
"""Stages after the training: the beginning of the keys of their units."""


def plan(scale: str, phases: Sequence[int], store: Path) -> list[Unit]:
    """Return the units of a scale: training runs, then what comes after each of them."""
    return list(grid_units(make_grid(scale, phases), store))


def grid_units(grid: Grid, store: Path) -> Iterator[Unit]:
    """Yield the units of a grid.

    Methods whose input depends on C are evaluated on validation start states too, where C is chosen.
    """
    for row in grid.rows:
        run = train_run(grid, row)
        for seed in row.seeds:
            training = run.unit(seed)
            yield training
            if row.evaluated:
                yield from _later_units(grid, row, seed, training, (store / training.key / POLICY).resolve())


def _later_units(grid: Grid, row: Row, seed: int, training: Unit, path: Path) -> Iterator[Unit]:
    def unit(stage: str, function: str, settings: dict[str, Any], size: float) -> Unit:
        config = {"training": dict(training.config), **settings}
        arguments = {"path": str(path), **settings}
        return Unit(f"{stage}/{row.key}/seed-{seed}", config, function, arguments, (training.key,), size)

    clocks = grid.clocks(row)
    known = Extrapolation(clocks=clocks or OWN_CLOCK)
    deployed = known.deployment_clocks(None, grid.steps) if clocks else (None,)
    for split in grid.splits:
        if split.name == TEST or row.method in SWEPT:
            settings = {"clocks": list(clocks), "steps": grid.steps, "first": split.first_seed, "seeds": split.seeds}
            size = 0.3 * grid.steps * split.seeds * len(deployed)
            yield unit(f"{EVALUATION}/{split.name}", f"{__name__}:evaluate", settings, size)
    yield unit(MECHANISM, "studies.horizon.rollouts:measure", {}, 1500.0 * ROLLOUTS)
    if row.method in SWEPT:
        candidates = sorted(float(each.steps) for each in deployed if isinstance(each, Constant) and each.steps > 0)
        settings = {"candidates": candidates, "most_steps": grid.steps}
        yield unit(RULES, "studies.horizon.rollouts:choose_clock", settings, 50_000.0)


def train_run(grid: Grid, row: Row) -> TrainRun:
    """Return the training run of a row; its units are those of `perdure train TASK --method METHOD --preset PRESET`.

    For NOISY_START the command also has `--ppo.log-std-init 0`.
    """
    from perdure.learn.run import TrainRun

    return TrainRun(row.task, row.method, row_config(grid, row), row.seeds, preset=row.preset)


def row_config(grid: Grid, row: Row) -> PPOConfig:
    """Return the learner's settings of a row."""
    config = method_config(row.method, row.task, task_spec(row.task).observation_size, row.preset)
    if row.task in NOISY_START:
        config = replace(config, log_std_init=0.0)
    if grid.training_steps is not None:
        config = replace(config, total_steps=grid.training_steps)
    return config


def evaluate(work: Work, *, path: str, clocks: Sequence[str], steps: int, first: int, seeds: int) -> None:
    """Evaluate one policy in this process and leave its table; an interrupted attempt keeps its finished episodes."""
    store = work.folder / "episodes"
    if not (work.folder / TABLE_FILE).is_file():
        clocks = tuple(clocks) or OWN_CLOCK
        evaluation = Extrapolation((Path(path),), steps, clocks, seeds, first_eval_seed=first, disturb=("none",))
        evaluate_files(
            evaluation, Execution(store, on="here", observe=lambda status: work.report(total_share(status), 1.0))
        )
        (store / TABLE_FILE).replace(work.folder / TABLE_FILE)
    shutil.rmtree(store, ignore_errors=True)


def collect(store: Path, out: Path) -> list[Path]:
    """Copy the finished units of a store into the frozen tables and policies under `out`, and return the files.

    Training runs of `perdure train --out STORE` are units of it too, whether or not a grid names them.
    """
    finished = Store(store)
    seeds = [key for key in finished.keys("") if key.rpartition("/")[2].startswith("seed-")]
    keys = [key for key in seeds if key.count("/") == 2 or key.partition("/")[0] in STAGES]
    parts: dict[FrozenTable, list[pl.DataFrame]] = {table: [] for table in TABLES}
    policies = []
    for key in keys:
        folder = finished.get(key)
        # Of a training run: TASK/METHOD@PRESET/seed-K; of later units STAGE/... before it.
        *stage, task, variant, seed = key.split("/")
        method, at, preset = variant.partition("@")
        setting = f"{task}{at}{preset}"
        train_seed = int(seed.removeprefix("seed-"))
        if not stage:
            if (folder / POLICY).is_file():  # of some early runs only the curves were kept
                policy = load_policy(folder / POLICY).without_critic()
                policies.append(save_policy(policy, out / "policies" / task / variant / f"{seed}.safetensors"))
            curve = read_parquet_file(folder / "episodes.parquet")
            parts[LEARNING].append(freeze_learning(curve, setting, method, train_seed))
        elif stage[0] == EVALUATION:
            parts[EPISODES].append(freeze_episodes(read_table(folder / TABLE_FILE)[0], setting, method, stage[1]))
        else:
            rows = json.loads((folder / RESULT).read_text())
            table = CLOCKS
            if stage[0] == MECHANISM:
                table = MECHANISMS
                rows = [{"measure": measure, "at": steps, "result": result} for measure, steps, result in rows]
            named = {"setting": setting, "method": method, "train_seed": train_seed}
            parts[table].append(pl.DataFrame([named | row for row in rows], schema=table.columns))
    return [*(table.add(out, pl.concat(found)) for table, found in parts.items() if found), *policies]


def analyze(scale: str, out: Path) -> list[Path]:
    """Write tables and figures from the frozen tables, and include tables in the page if there is one.

    Finished units of the study's own store, OUT/runs, are collected first.

    Raises:
        PerdureError: There are no frozen tables.
    """
    from studies.horizon.figures import all_figures
    from studies.horizon.tables import all_tables, page_tables

    if (out / "runs").is_dir():
        collect(out / "runs", out)
    if not (out / LEARNING.file).is_file():
        raise PerdureError(f"there are no results of the study horizon in {out}; run it first, or name another --out")
    results = read_results(GRIDS[scale], out)
    written = [write_csv(out / "tables" / f"{name}.csv", frame) for name, frame in all_tables(results).items()]
    written += save(all_figures(results), out / "figures", ("svg",))
    page = out / "README.md"
    if page.is_file():
        written.append(include_tables(page, page_tables(results)))
    return written
