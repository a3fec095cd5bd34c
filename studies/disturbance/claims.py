"""The registered claims (results/horizon/registered.md), decided, and one more: ten fresh runs of each method.

A claim is about the mean over tasks of the difference of two methods' means over training runs. Claims are tested in
their order at 5 %; the first that fails ends the decisions.
"""

from __future__ import annotations

from dataclasses import dataclass
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
POWER_SAMPLES, POWER_RESAMPLES = 200, 999
LEAST_GAIN = 0.25
"""Of discounted PPO's mean calm gain: a run below it stands rather than works, and its working share is 0."""
GAIN = pl.col("training_rate") - pl.col("idle_rate")
SCALE = pl.col("published_rate") - pl.col("idle_rate")
"""A published policy's gain per step over an idle robot."""
NOISE, PUSHES, CALM = "action noise 0.1", "pushes of 0.5 m/s", "calm"


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
    runs, rows, ended = measure_runs(episodes), [], False
    for number, claim in enumerate(CLAIMS, 1):
        here = runs.filter(condition=claim.condition)
        sides = sides_by_task(runs, claim)
        complete = len(sides) == len(TASKS) and all(len(side) == 10 for pair in sides.values() for side in pair)
        rows += [_row(number, claim, task, {task: pair}, here.filter(task=task)) for task, pair in sides.items()]
        if len(sides) > 1 and all(len(side) > 1 for pair in sides.values() for side in pair):
            row = _row(number, claim, ", ".join(sides), sides, here.filter(pl.col("task").is_in(list(sides))))
            won = row["lower 5 %"] > -claim.margin if claim.margin else row["p"] <= LEVEL
            decision = "not tested" if ended else "supported" if won else "not shown"
            decided = decision if complete else "runs are missing"
            rows.append(row | {"decision": decided if claim.registered else "unregistered"})
            ended = ended or not won
        ended = ended or not complete
    return pl.DataFrame(rows, infer_schema_length=None)


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
    pairs, rng = list(sides.values()), np.random.default_rng(number)
    low, lower, high = np.quantile(resampled_difference(pairs, rng), (0.025, LEVEL, 0.975))
    return {
        "claim": number,
        **{name: getattr(claim, name) for name in ("left", "right", "condition", "measure")},
        "task": task,
        "runs": min(len(side) for pair in pairs for side in pair),
        "left mean": np.mean([left.mean() for left, _ in pairs]),
        "right mean": np.mean([right.mean() for _, right in pairs]),
        "left speed": speeds[claim.left],
        "right speed": speeds[claim.right],
        "effect": difference(pairs),
        "low": low,
        "high": high,
        "lower 5 %": lower,
        "p": permutation_p(pairs, rng, RESAMPLES, claim.two_sided),
        "power": power(pairs, claim, rng) if len(pairs) > 1 else None,
        "decision": None,
    }


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
    reached = np.abs(drawn) >= abs(observed) - 1e-12 if two_sided else drawn >= observed - 1e-12
    return float((1 + reached.sum()) / (1 + resamples))


def power(pairs: list[Sides], claim: Claim, rng: np.random.Generator) -> float:
    """Return how often the claim's test would be passed by as many new runs like these: bootstrap over runs."""
    passed = 0
    for _ in range(POWER_SAMPLES):
        drawn = [(rng.choice(left, len(left)), rng.choice(right, len(right))) for left, right in pairs]
        if claim.margin:
            error = np.sqrt(sum(side.var(ddof=1) / len(side) for pair in drawn for side in pair)) / len(drawn)
            passed += difference(drawn) - 1.645 * error > -claim.margin
        else:
            passed += permutation_p(drawn, rng, POWER_RESAMPLES, claim.two_sided) <= LEVEL
    return passed / POWER_SAMPLES
