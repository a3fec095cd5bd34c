"""The registered claims (results/cure/registered.md), decided.

A claim is about the mean over tasks of the difference of two kinds of training runs. Claims are tested in their order
at 5 %; the first that is not significant ends the decisions.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import polars as pl

from perdure.stats import FloatArray
from studies.cure.grid import ANT_SEEDS, BASE, BASE_SEEDS
from studies.disturbance.claims import GAIN, LEVEL, SCALE, Sides, difference, permutation_p, run_counts
from studies.disturbance.grid import TASKS

RESAMPLES = 100_000
STANDARD = "standard-1"
CALM = "calm"
ANT = ("Ant-v3",)


@dataclass(frozen=True)
class Claim:
    """Left has more of a measure than right; or, two-sided, differs."""

    left: str
    right: str
    condition: str = STANDARD
    measure: str = "work"
    tasks: tuple[str, ...] = TASKS
    seeds: tuple[int, ...] = BASE_SEEDS
    paired: bool = True
    """By the base run that both sides continue."""
    two_sided: bool = False


CLAIMS = (
    Claim("continued-long-noise", BASE),
    Claim("continued-long-noise", "continued-noise"),
    Claim("continued-long-noise", "continued-long"),
    Claim("continued-long-noise", "geometric-noise-1.3M", paired=False),
    Claim("geometric-quiet", "ppo-quiet", CALM, "score", ANT, ANT_SEEDS, paired=False),
    Claim("continued-geometric-noise", "continued-long-noise", two_sided=True),
)
"""In the order of their tests."""


def measure_runs(episodes: pl.DataFrame) -> pl.DataFrame:
    """Return one row for each training run and condition, from a row for each episode.

    | measure | of an episode | of a run |
    |---|---|---|
    | work | (return - idle rate x steps until its end) / ((published rate - idle rate) x all its steps) | mean |
    | score | (return / all its steps - idle rate) / (published rate - idle rate) | mean |
    | holding share | 1 if its outcome is "holds" | mean |
    | speed | (rate within the training horizon, calm - idle rate) / (published rate - idle rate) | |
    | steps between failures | steps before failure, divided by the number of failures | ratio of sums |
    """
    idle_return = pl.col("idle_rate") * pl.col("end_step")
    failed = pl.col("failed_step") < pl.col("test_horizon")
    return (
        episodes.with_columns(
            work=(pl.col("return") - idle_return) / (SCALE * pl.col("test_horizon")),
            score=(pl.col("return") / pl.col("test_horizon") - pl.col("idle_rate")) / SCALE,
        )
        .group_by("task", "arm", "train_seed", "condition")
        .agg(
            pl.col("work").mean(),
            pl.col("score").mean(),
            (pl.col("outcome") == "holds").mean().alias("holding share"),
            (GAIN / SCALE).first().alias("speed"),
            (pl.col("failed_step").sum() / failed.sum()).alias("steps between failures"),
        )
        .sort("task", "arm", "train_seed", "condition")
    )


def claims_table(episodes: pl.DataFrame) -> pl.DataFrame:
    """Return the decided claims: a row for each task, and one for their mean, which has the decision.

    Args:
        episodes: A row for each episode: columns of the evaluation table, `arm` and `condition`.
    """
    runs = measure_runs(episodes)
    rows: list[dict[str, Any]] = []
    ended = False
    for number, claim in enumerate(CLAIMS, 1):
        here = runs.filter(condition=claim.condition)
        sides = {task: _sides(here.filter(task=task), claim) for task in claim.tasks}

        # A row for each task that has several runs of both sides.
        for task, pair in sides.items():
            if min(run_counts([pair])) > 1:
                rows.append(_row(number, claim, task, {task: pair}, here))

        # The mean over tasks, which decides.
        if set(run_counts(sides.values())) != {len(claim.seeds)}:
            rows.append({"claim": number, "left": claim.left, "right": claim.right, "decision": "runs are missing"})
            ended = True
            continue
        row = _row(number, claim, ", ".join(sides), sides, here)
        significant = row["p"] <= LEVEL
        if ended:
            row["decision"] = "not tested"
        elif significant:
            row["decision"] = "supported"
        else:
            row["decision"] = "not shown"
        rows.append(row)
        ended = ended or not significant
    return pl.DataFrame(rows, infer_schema_length=None)


def _sides(runs: pl.DataFrame, claim: Claim) -> Sides:
    """Return the measure of each training run of both sides; where they are paired, of the seeds that both have."""
    left = runs.filter(pl.col("train_seed").is_in(claim.seeds), arm=claim.left)
    right = runs.filter(pl.col("train_seed").is_in(claim.seeds), arm=claim.right)
    if claim.paired:
        left = left.join(right, "train_seed", "semi")
        right = right.join(left, "train_seed", "semi")
    return left.sort("train_seed")[claim.measure].to_numpy(), right.sort("train_seed")[claim.measure].to_numpy()


def _row(number: int, claim: Claim, task: str, sides: dict[str, Sides], runs: pl.DataFrame) -> dict[str, Any]:
    pairs = list(sides.values())
    rng = np.random.default_rng(number)
    low, high = np.quantile(_bootstrap(pairs, claim.paired, rng), (0.025, 0.975))
    test = permutation_p
    if claim.paired:
        test = sign_flip_p
    there = runs.filter(pl.col("task").is_in(list(sides)))
    speeds = dict(there.group_by("arm").agg(pl.col("speed").mean()).iter_rows())
    return {
        "claim": number,
        "left": claim.left,
        "right": claim.right,
        "condition": claim.condition,
        "measure": claim.measure,
        "task": task,
        "runs": min(run_counts(pairs)),
        "left mean": float(np.mean([left.mean() for left, _ in pairs])),
        "right mean": float(np.mean([right.mean() for _, right in pairs])),
        "left speed": speeds[claim.left],
        "right speed": speeds[claim.right],
        "effect": difference(pairs),
        "low": float(low),
        "high": float(high),
        "p": test(pairs, rng, RESAMPLES, claim.two_sided),
        "decision": None,
    }


def sign_flip_p(pairs: list[Sides], rng: np.random.Generator, resamples: int, two_sided: bool = False) -> float:
    """Return the p value of random signs of the paired differences within tasks; the observed signs count."""
    drawn = np.zeros(resamples)
    for left, right in pairs:
        signs = rng.choice((-1.0, 1.0), size=(resamples, len(left)))
        drawn += (signs * (left - right)).mean(axis=1) / len(pairs)
    observed = difference(pairs)
    if two_sided:
        reached = np.abs(drawn) >= abs(observed) - 1e-12
    else:
        reached = drawn >= observed - 1e-12
    return float((1 + reached.sum()) / (1 + resamples))


def _bootstrap(pairs: list[Sides], paired: bool, rng: np.random.Generator) -> FloatArray:
    """Return effects of bootstrap samples of training runs, pairs kept together, shape (RESAMPLES,)."""
    drawn = np.zeros(RESAMPLES)
    for left, right in pairs:
        of_left = rng.integers(len(left), size=(RESAMPLES, len(left)))
        of_right = of_left
        if not paired:
            of_right = rng.integers(len(right), size=(RESAMPLES, len(right)))
        drawn += (left[of_left].mean(axis=1) - right[of_right].mean(axis=1)) / len(pairs)
    return drawn
