"""The registered claims (results/horizon/registered.md), decided, and one more: ten fresh runs of each method.

A claim is about the mean over tasks of the difference of two methods' means over training runs. Claims are tested in
their order at 5 %; the first that fails ends the decisions.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import chain
from typing import Any

import numpy as np
import polars as pl

from perdure.report.schema import EPISODE
from perdure.stats import FloatArray
from studies.disturbance.grid import TASKS

Sides = tuple[FloatArray, FloatArray]
"""Of a task: a value for each training run of the left method, and of the right."""
LEVEL = 0.05
RESAMPLES = 20_000
POWER_SAMPLES = 200
POWER_RESAMPLES = 999
LEAST_GAIN = 0.25
"""Of discounted PPO's mean calm gain: a run below it stands rather than works, and its working share is 0."""
GAIN = pl.col("training_rate") - pl.col("idle_rate")
SCALE = pl.col("published_rate") - pl.col("idle_rate")
"""A published policy's gain per step over an idle robot."""
NOISE = "action noise 0.1"
PUSHES = "pushes of 0.5 m/s"
CALM = "calm"


@dataclass(frozen=True)
class Claim:
    """Left beats right by more than minus the margin; or, two-sided, differs."""

    left: str
    right: str
    condition: str
    measure: str
    margin: float = 0.0
    two_sided: bool = False
    registered: bool = True


CLAIMS = (
    Claim("geometric", "ppo", NOISE, "working share"),
    Claim("geometric", "ppo", PUSHES, "working share"),
    Claim("geometric", "geometric-discounted", NOISE, "working share"),
    Claim("geometric", "ppo-gamma-0.999", CALM, "gain in training", two_sided=True),
    Claim("geometric", "ppo", CALM, "score", margin=0.1),
    Claim("geometric", "ppo-gamma-0.999", NOISE, "working share", two_sided=True, registered=False),
)
"""In the order of their tests. The fifth is decided by its interval, the others by permutation."""


def speed_while_working(frame: pl.DataFrame) -> pl.Series:
    """Return, for each episode of an evaluation table, the reward per step until its last record before the failure.

    nan: it failed before the first record. Rows are in the order of `ExtrapolationResult.final`.
    """
    before = pl.col("step") <= pl.col("failed_step")
    rate = (pl.col("return") / pl.col("step")).filter(before).sort_by(pl.col("step").filter(before)).last()
    known = frame.group_by(*EPISODE).agg(speed=rate)
    last = frame.filter(pl.col("step") == pl.col("test_horizon")).select(EPISODE)
    return last.join(known, EPISODE, "left", maintain_order="left")["speed"].fill_null(float("nan"))


def claims_table(episodes: pl.DataFrame) -> pl.DataFrame:
    """Return the decided claims, a row for each task and one for their mean.

    Args:
        episodes: Rows of the frozen table of fresh runs: a row for each episode.
    """
    runs = measure_runs(episodes)
    rows: list[dict[str, Any]] = []
    ended = False
    for number, claim in enumerate(CLAIMS, 1):
        here = runs.filter(condition=claim.condition)
        sides = sides_by_task(runs, claim)
        sizes = run_counts(sides.values())
        complete = len(sides) == len(TASKS) and set(sizes) == {10}

        # A row for each task.
        for task, pair in sides.items():
            rows.append(_row(number, claim, task, {task: pair}, here.filter(task=task)))

        # Their mean, which decides.
        if len(sides) > 1 and min(sizes) > 1:
            row = _row(number, claim, ", ".join(sides), sides, here.filter(pl.col("task").is_in(list(sides))))
            won = _is_won(claim, row)
            row["decision"] = _decision(claim, complete, ended, won)
            rows.append(row)
            ended = ended or not won
        ended = ended or not complete
    return pl.DataFrame(rows, infer_schema_length=None)


def run_counts(pairs: Iterable[Sides]) -> list[int]:
    """Return the number of training runs of each side of each task."""
    counts = []
    for left, right in pairs:
        counts += [len(left), len(right)]
    return counts


def _is_won(claim: Claim, row: dict[str, Any]) -> bool:
    """Return whether the mean over tasks, a row of the table, supports a claim."""
    if claim.margin:
        return bool(row["lower 5 %"] > -claim.margin)
    return bool(row["p"] <= LEVEL)


def _decision(claim: Claim, complete: bool, ended: bool, won: bool) -> str:
    """Return the word for a claim; `ended`: a claim before it failed."""
    if not claim.registered:
        return "unregistered"
    if not complete:
        return "runs are missing"
    if ended:
        return "not tested"
    if won:
        return "supported"
    return "not shown"


def sides_by_task(runs: pl.DataFrame, claim: Claim) -> dict[str, Sides]:
    """Return the two sides of a claim on each task that has runs of both, from `measure_runs`."""
    sides = {}
    for (task,), part in sorted(runs.filter(condition=claim.condition).group_by("task")):
        left = part.filter(method=claim.left)[claim.measure].to_numpy()
        right = part.filter(method=claim.right)[claim.measure].to_numpy()
        if len(left) and len(right):
            sides[str(task)] = (left, right)
    return sides


def measure_runs(episodes: pl.DataFrame, least_gain: float = LEAST_GAIN) -> pl.DataFrame:
    """Return one row for each training run and condition, with every measure, from a row for each episode.

    Work and score compare the return with that of an idle robot, as a share of a published policy's over the whole
    episode. The idle robot of work earns until the episode ends, that of the score for the whole episode, so that an
    early fall scores below 0.

    Args:
        episodes: Rows of the frozen table of fresh runs.
        least_gain: A run whose calm gain is below this share of discounted PPO's stands; its working share is 0.
    """
    rate = pl.col("return") / pl.col("test_horizon")
    work = (pl.col("return") - pl.col("idle_rate") * pl.col("end_step")) / (SCALE * pl.col("test_horizon"))
    return (
        episodes.with_columns(method=pl.col("method").str.split("@").list.first())
        .group_by("task", "method", "train_seed", "condition")
        .agg(
            GAIN.first().alias("gain"),
            (GAIN / SCALE).first().alias("gain in training"),
            (pl.col("failed_step") / pl.col("test_horizon")).mean().alias("working share"),
            ((rate - pl.col("idle_rate")) / SCALE).mean().alias("score"),
            work.mean().alias("work"),
            ((pl.col("speed") - pl.col("idle_rate")) / SCALE).drop_nans().mean().alias("speed"),  # while working
        )
        .with_columns(least=least_gain * pl.col("gain").filter(pl.col("method") == "ppo").mean().over("task"))
        .with_columns(
            pl.when(pl.col("gain") < pl.col("least")).then(0.0).otherwise("working share").alias("working share")
        )
        .sort("task", "method", "train_seed")
    )


def _row(number: int, claim: Claim, task: str, sides: dict[str, Sides], runs: pl.DataFrame) -> dict[str, Any]:
    by_task = runs.group_by("task", "method").agg(pl.col("speed").mean())
    speeds = dict(by_task.group_by("method").agg(pl.col("speed").mean()).iter_rows())
    pairs = list(sides.values())
    rng = np.random.default_rng(number)
    low, lower, high = np.quantile(resampled_difference(pairs, rng), (0.025, LEVEL, 0.975))
    row = {
        "claim": number,
        "left": claim.left,
        "right": claim.right,
        "condition": claim.condition,
        "measure": claim.measure,
        "task": task,
        "runs": min(run_counts(pairs)),
        "left mean": np.mean([left.mean() for left, _ in pairs]),
        "right mean": np.mean([right.mean() for _, right in pairs]),
        "left speed": speeds[claim.left],
        "right speed": speeds[claim.right],
        "effect": difference(pairs),
        "low": low,
        "high": high,
        "lower 5 %": lower,
        "p": permutation_p(pairs, rng, RESAMPLES, claim.two_sided),
        "power": None,
        "decision": None,
    }
    if len(pairs) > 1:
        row["power"] = power(pairs, claim, rng)
    return row


def _resampled(values: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Return means of bootstrap samples of training runs."""
    return np.asarray(values[rng.integers(len(values), size=(RESAMPLES, len(values)))].mean(axis=1))


def resampled_difference(pairs: list[Sides], rng: np.random.Generator) -> FloatArray:
    """Return the difference in bootstrap samples of training runs within tasks."""
    return np.asarray(sum(_resampled(left, rng) - _resampled(right, rng) for left, right in pairs) / len(pairs))


def difference(pairs: list[Sides]) -> float:
    """Return the mean over tasks of left's mean minus right's."""
    return float(np.mean([left.mean() - right.mean() for left, right in pairs]))


def permutation_p(pairs: list[Sides], rng: np.random.Generator, resamples: int, two_sided: bool = False) -> float:
    """Return the p value of a permutation of training runs within tasks (stratified); the observed one counts."""
    drawn = np.zeros(resamples)
    for left, right in pairs:
        pooled = rng.permuted(np.tile(np.concatenate([left, right]), (resamples, 1)), axis=1)
        drawn += (pooled[:, : len(left)].mean(axis=1) - pooled[:, len(left) :].mean(axis=1)) / len(pairs)
    observed = difference(pairs)
    if two_sided:
        reached = np.abs(drawn) >= abs(observed) - 1e-12
    else:
        reached = drawn >= observed - 1e-12
    return float((1 + reached.sum()) / (1 + resamples))


def power(pairs: list[Sides], claim: Claim, rng: np.random.Generator) -> float:
    """Return how often the claim's test would be passed by as many new runs like these: bootstrap over runs."""
    passed = 0
    for _ in range(POWER_SAMPLES):
        drawn = [(rng.choice(left, len(left)), rng.choice(right, len(right))) for left, right in pairs]
        if claim.margin:
            variances = [side.var(ddof=1) / len(side) for side in chain(*drawn)]
            error = np.sqrt(sum(variances)) / len(drawn)
            passed += difference(drawn) - 1.645 * error > -claim.margin
        else:
            passed += permutation_p(drawn, rng, POWER_RESAMPLES, claim.two_sided) <= LEVEL
    return passed / POWER_SAMPLES
