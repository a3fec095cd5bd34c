"""An audit of published agents: the verdict of `perdure extrapolate` on each, and of `perdure cure` where it applies.

The agents are the MuJoCo ones of RL Baselines3 Zoo, from https://github.com/DLR-RM/rl-trained-agents (MIT license),
cloned into the folder `AGENTS`. Actions of SAC and TQC go through tanh and ARS has no hidden layer, so no PPO continues
them.
"""

from __future__ import annotations

import json
import math
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import polars as pl

from perdure.errors import PerdureError
from perdure.evaluate import Execution, Extrapolation, evaluate_files
from perdure.evaluate.cure import cure
from perdure.policy.readers.found import policy_file
from perdure.report import wording
from perdure.report.estimates import Estimate, estimate_table
from perdure.report.outcomes import Holds
from perdure.runs import Store, Unit, Work, file_digest, write_atomic
from perdure.runs.progress import total_share
from studies.files import include_tables, write_csv

QUESTION = "Do published agents hold?"
SCALES = {"thesis": Path("results", "agents")}
PHASES = {1: "the verdict on every agent", 2: "the cure of those that PPO can continue"}
AGENTS = Path("rl-trained-agents")
ALGORITHMS = ("ppo", "a2c", "trpo", "sac", "tqc", "ars")
CURED = ("ppo", "a2c", "trpo")
TASKS = ("Hopper-v3", "Walker2d-v3", "HalfCheetah-v3", "Swimmer-v3", "Ant-v3", "Humanoid-v3")
ROWS = "rows.json"
VERDICTS = "verdicts.csv"
CONDITIONS = {"none": "calm", "standard-1": "disturbed"}
NAMES = {name: name.upper() for name in ALGORITHMS}
RATES = ("idle_rate", "training_rate", "published_rate")
WHEN = {1: "published", 2: "cured"}


def plan(scale: str, phases: Sequence[int], store: Path) -> list[Unit]:
    """Return the units: one for each agent and phase.

    Raises:
        PerdureError: The agents are not there.
    """
    units = []
    for phase in phases:
        for algorithm in ALGORITHMS if phase == 1 else CURED:
            for task in TASKS:
                folder = AGENTS / algorithm / f"{task}_1"
                if folder.is_dir():
                    units.append(_unit(phase, algorithm, task, folder))
    if not units:
        raise PerdureError(f"there is no agent in {AGENTS}: git clone https://github.com/DLR-RM/rl-trained-agents")
    return units


def _unit(phase: int, algorithm: str, task: str, folder: Path) -> Unit:
    config = {"model": file_digest(folder / f"{task}.zip"), "phase": phase}
    arguments = {"path": str(folder.resolve()), "phase": phase}
    return Unit(f"{WHEN[phase]}/{algorithm}/{task}", config, f"{__name__}:audit", arguments, size=float(phase))


def audit(work: Work, *, path: str, phase: int) -> None:
    """Judge an agent as published, or after the cure, and leave a row for each condition; the function of the units."""
    store = work.folder / "parts"
    if phase == 2:
        result = cure(path, out=store, on="here")
        groups = result.cured.after
        seconds = result.training_seconds
    else:
        file = policy_file(path, store, None, {}, (), lambda sentence: None)
        execution = Execution(
            store / "episodes", on="here", observe=lambda status: work.report(total_share(status), 1.0)
        )
        (groups,) = estimate_table(evaluate_files(Extrapolation((file,)), execution).frame).values()
        seconds = 0.0
    rows = [{**row_of(item), "training_seconds": seconds} for item in groups]
    write_atomic(work.folder / ROWS, json.dumps(rows))
    shutil.rmtree(store, ignore_errors=True)


def row_of(item: Estimate) -> dict[str, Any]:
    """Return what is kept of a policy under one condition. Rates are rewards per step."""
    group = item.group
    episode = group.facts.row(0, named=True)
    rate = group.failure_rate
    return {
        "condition": group.disturbance,
        "verdict": item.verdict.label,
        "reasons": "; ".join(item.verdict.caveats.values()),
        "episodes": group.episodes,
        "hold": group.verdicts.count(Holds.name),
        "test_horizon": group.test_horizon,
        "median_failure_step": None if math.isnan(group.half_failed_by) else group.half_failed_by,
        "failures": rate.events if rate else None,
        "hours": rate.exposure_hours if rate else None,
        "work": float(item.work_vs_published.estimate),
        **{name: episode[name] for name in RATES},
    }


def analyze(scale: str, out: Path) -> list[Path]:
    """Write the table of verdicts, after finished units are collected, and the tables of the page `README.md`.

    Raises:
        PerdureError: There are no results.
    """
    if (out / "runs").is_dir():
        write_csv(out / VERDICTS, collect(Store(out / "runs")))
    if not (out / VERDICTS).is_file():
        raise PerdureError(f"there are no results of the study agents in {out}; run it first")
    written = [out / VERDICTS]
    page = out / "README.md"
    if page.is_file():
        written.append(include_tables(page, {"agents": page_table(pl.read_csv(out / VERDICTS))}))
    return written


def collect(store: Store) -> pl.DataFrame:
    """Return a row for each agent, phase and condition that is finished."""
    rows = []
    for unit in plan("thesis", [*PHASES], store.root):
        if store.done(unit.key):
            when, algorithm, task = unit.key.split("/")
            who = {"task": task, "algorithm": algorithm, "when": when}
            found = json.loads((store.get(unit.key) / ROWS).read_text())
            rows += [who | row for row in found]
    return pl.DataFrame(rows, infer_schema_length=None)


def page_table(verdicts: pl.DataFrame) -> pl.DataFrame:
    """Return the table of the page: a row for each agent, as published and cured."""
    rows = []
    for task in TASKS:
        for algorithm in ALGORITHMS:
            mine = verdicts.filter(task=task, algorithm=algorithm)
            if mine.is_empty():
                continue
            row = {"task": task, "agent": NAMES[algorithm]}
            for when in WHEN.values():
                for condition, words in CONDITIONS.items():
                    row[f"{words}, {when}"] = _cell(mine.filter(when=when, condition=condition))
            rows.append(row)
    return pl.DataFrame(rows)


def _cell(rows: pl.DataFrame) -> str:
    """Return a verdict in words: "falls (0 of 36, every 7.2 s)"; "" where there is none."""
    if rows.is_empty():
        return ""
    row = rows.row(0, named=True)
    parts = [f"{row['hold']} of {row['episodes']}"]
    if row["failures"]:
        parts.append(f"every {wording.duration(row['hours'] / row['failures'])}")
    elif row["median_failure_step"]:
        parts.append(f"half by step {row['median_failure_step']:,.0f}")
    return f"{row['verdict']} ({', '.join(parts)})"
