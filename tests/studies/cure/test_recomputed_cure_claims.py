"""The claims of the cure by the text of results/cure/registered.md: all sign patterns instead of random ones.

Nothing of perdure or of the studies is imported.
"""

from itertools import product
from math import sqrt
from pathlib import Path

import numpy as np
import polars as pl
import pytest

RESULTS = Path(__file__).parents[3] / "results"
CLAIMS = pl.read_csv(RESULTS / "cure" / "tables" / "claims.csv")
BASE = "ppo"
PRESETS = {"Hopper-v3": "@cleanrl", "Walker2d-v3": "@cleanrl", "HalfCheetah-v3": ""}
TWO_SIDED = (6,)
PAIRED = (1, 2, 3, 6)
RANDOM_SIGNS = 100_000


def works(task, arm):
    """Training seed to the mean work of its five episodes of 10,000 steps under standard-1."""
    if arm == BASE:
        rows = pl.read_parquet(RESULTS / "disturbance" / "registered.parquet")
        rows = rows.filter(pl.col("train_seed") >= 13, task=task, method=BASE + PRESETS[task], condition="standard-1")
    else:
        rows = pl.read_parquet(RESULTS / "cure" / "episodes.parquet")
        rows = rows.filter(task=task, arm=arm, condition="standard-1")
    found = {}
    for seed in rows["train_seed"].unique():
        run = rows.filter(train_seed=seed)
        assert sorted(run["eval_seed"]) == [3000, 3001, 3002, 3003, 3004]
        assert set(run["test_horizon"]) == {10_000}
        gained = [row["return"] - row["idle_rate"] * row["end_step"] for row in run.iter_rows(named=True)]
        published = (run["published_rate"][0] - run["idle_rate"][0]) * 10_000
        found[seed] = float(np.mean(gained)) / published
    return found


def differences(row, task):
    """Left minus right of each base run that both sides have, in the order of the seeds."""
    left = works(task, row["left"])
    right = works(task, row["right"])
    return np.array([left[seed] - right[seed] for seed in sorted(left.keys() & right.keys())])


def means_under_all_signs(found):
    """The means of the differences under each of the 2 ** n choices of their signs."""
    return np.array(list(product((-1.0, 1.0), repeat=len(found)))) @ found / len(found)


PAIRED_ROWS = CLAIMS.filter(pl.col("claim").is_in(PAIRED), pl.col("effect").is_not_null()).to_dicts()


def test_at_least_the_first_claim_is_checked():
    assert any(row["claim"] == 1 and row["decision"] for row in PAIRED_ROWS)


@pytest.mark.parametrize("row", PAIRED_ROWS, ids=lambda row: f"{row['claim']} {row['task']}")
def test_a_paired_claim(row):
    pairs = [differences(row, task) for task in row["task"].split(", ")]
    effect = np.mean([found.mean() for found in pairs])
    assert effect == pytest.approx(row["effect"], abs=1e-5)
    drawn = np.zeros(1)
    for found in pairs:
        drawn = np.add.outer(drawn, means_under_all_signs(found) / len(pairs)).ravel()
    if row["claim"] in TWO_SIDED:
        p = (np.abs(drawn) >= abs(effect) - 1e-12).mean()
    else:
        p = (drawn >= effect - 1e-12).mean()
    assert p == pytest.approx(row["p"], abs=4 * sqrt(p / RANDOM_SIGNS) + 1 / RANDOM_SIGNS)
