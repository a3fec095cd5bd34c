"""What makes policies fail more rarely: steps between failures under `standard-1`, and the speed they cost."""

from __future__ import annotations

import numpy as np
import polars as pl

from perdure.report.outcomes import NeverWorked
from studies.disturbance.claims import GAIN, SCALE
from studies.horizon.grid import METHODS

RESAMPLES = 2000
GOALS = {"speed": 0.75, "ratio": 3.0}
"""Of a cure: least speed against discounted PPO's, and least lower bound of the ratio of steps between failures."""


def cure_table(episodes: pl.DataFrame, seeds: str, baseline: pl.DataFrame | None = None) -> pl.DataFrame:
    """Return speed and steps between failures of each method, against discounted PPO's on the same task.

    Speed: score against a published policy, calm, within the training horizon, mean over training runs. Steps between
    failures: steps that work under `standard-1`, divided by the number of failures plus one, so that a method that
    never fails has a finite number. Intervals: bootstrap over training runs, of both methods.

    Args:
        episodes: A row for each episode; those of `standard-1` count.
        seeds: The training seeds of the episodes, in words.
        baseline: Episodes of discounted PPO, if `episodes` has none.
    """
    rows, rng = [], np.random.default_rng(0)
    runs, base_runs = _runs(episodes), _runs(episodes if baseline is None else baseline)
    for (task, method), part in sorted(runs.group_by("task", "method")):
        name, at, preset = str(method).partition("@")
        if not len(base := base_runs.filter(task=task, method=f"ppo{at}{preset}")):
            continue
        values, of_base = (each.select("speed", "steps", "failures").to_numpy().astype(float) for each in (part, base))
        drawn = _between(values[rng.integers(len(values), size=(RESAMPLES, len(values)))])
        other = _between(of_base[rng.integers(len(of_base), size=(RESAMPLES, len(of_base)))])
        low, high = np.quantile(drawn / other, (0.025, 0.975))
        speed = values[:, 0].mean() / of_base[:, 0].mean()
        rows.append(
            {
                "seeds": seeds,
                "task": task,
                "preset": preset or "zoo",
                "method": METHODS.get(name, name),
                "runs": len(part),
                "speed": values[:, 0].mean(),
                "speed against PPO": speed,
                "failures": int(values[:, 2].sum()),
                "steps between failures": float(_between(values)),
                "ratio to PPO": float(_between(values) / _between(of_base)),
                "low": low,
                "high": high,
                "reaches the goal": "yes" if speed >= GOALS["speed"] and low >= GOALS["ratio"] else "no",
            }
        )
    return pl.DataFrame(rows, infer_schema_length=None)


def _runs(episodes: pl.DataFrame) -> pl.DataFrame:
    """Return speed, steps and failures of each training run; one that never worked failed at step 0."""
    return (
        episodes.filter(condition="standard-1")
        .with_columns(failed_step=pl.col("failed_step") * (pl.col("policy_state") != NeverWorked.name))
        .group_by("task", "method", "train_seed")
        .agg(
            (GAIN / SCALE).first().alias("speed"),
            pl.col("failed_step").sum().alias("steps"),
            (pl.col("failed_step") < pl.col("test_horizon")).sum().alias("failures"),
        )
        .sort("task", "method", "train_seed")
    )


def _between(runs: np.ndarray) -> np.ndarray:
    """Return steps between failures; runs: (..., runs, 3), of which the last two are steps and failures."""
    steps, failures = runs[..., 1].sum(axis=-1), runs[..., 2].sum(axis=-1)
    return np.asarray(steps / (failures + 1.0))
