"""Sentences of docs/home/results.md that no table shows, computed from the committed tables."""

import json
from pathlib import Path

import polars as pl
import pytest
from scipy import stats

TABLES = Path(__file__).parents[3] / "results" / "placement" / "tables"


def test_after_holm_no_gain_with_drag_only_would_be_below_5_percent():
    """Six paired differences of three policy sets each; the p value follows from the lower bound (Student t)."""
    found = pl.read_csv(TABLES / "differences.csv").filter(
        pl.col("split") == "eval",
        pl.col("world") == "drag",
        pl.col("first") == "rl",
        pl.col("second").is_in(["stop", "ik"]),
    )
    estimate, lower = (found[f"episodes {name}"].to_numpy() for name in ("estimate", "lower"))
    error = (estimate - lower) / stats.t.ppf(0.975, 2)
    p = sorted(2 * stats.t.sf(estimate / error, 2))
    assert len(p) == 6
    assert (lower > 0).all()
    assert max(p) < 0.05 < 6 * min(p)


@pytest.mark.parametrize("second", ["stop", "ik"])
def test_success_rises_in_each_policy_set_of_each_task(second):
    rows = json.loads((TABLES / "strategies.json").read_text())["rows"]
    seeds = {
        (row["task"], row["strategy"]): row["stabilizing"]["train_seeds"] for row in rows if row["split"] == "eval"
    }
    for task in ("set_table", "tidy_house", "prepare_groceries"):
        alone, stopped = seeds[task, "rl drag"], seeds[task, f"{second} drag"]
        assert len(alone) == 3
        assert all(after > before for before, after in zip(alone, stopped, strict=True))
