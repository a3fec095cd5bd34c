"""The registered claims: tests with known answers, and the order of the decisions."""

from itertools import product

import numpy as np
import polars as pl
import pytest
from scipy import stats

from studies.disturbance.claims import (
    CALM,
    CLAIMS,
    NOISE,
    PUSHES,
    claims_table,
    permutation_p,
    power,
    speed_while_working,
)

TASKS, METHODS = ("A", "B", "C"), ("ppo", "geometric", "geometric-discounted", "ppo-gamma-0.999")


@pytest.fixture(autouse=True)
def few_power_samples(monkeypatch):
    """No decision depends on the power, which has its own test below."""
    monkeypatch.setattr("studies.disturbance.claims.POWER_SAMPLES", 2)


def fresh_runs(life, geometric_gain=1.0):
    """A row for each episode: `life` maps (method, condition) to the share of the steps before failure."""
    rng = np.random.default_rng(1)
    rows = []
    for task, method, seed, condition in product(TASKS, METHODS, range(10, 20), (NOISE, PUSHES, CALM)):
        share = life.get((method, condition), 0.5) + rng.normal(0.0, 0.01)
        rows.append(
            {
                "task": task,
                "method": method,
                "train_seed": seed,
                "condition": condition,
                "test_horizon": 1000,
                "failed_step": 1000 * share,
                "end_step": 1000,
                "idle_rate": 0.0,
                "training_rate": geometric_gain if method == "geometric" else 1.0,
                "published_rate": 2.0,
                "return": 1000.0 * share,
                "speed": 1.0,
            }
        )
    return pl.DataFrame(rows)


def decisions(frame):
    *registered, last = claims_table(frame).drop_nulls("decision")["decision"].to_list()
    assert last == "unregistered"
    return registered


def test_permutation_of_two_and_two_runs_is_the_exact_share():
    pairs = [(np.array([3.0, 4.0]), np.array([1.0, 2.0]))]  # 1 of 6 splits is as extreme
    assert permutation_p(pairs, np.random.default_rng(0), 20_000) == pytest.approx(1 / 6, abs=0.01)
    assert permutation_p(pairs, np.random.default_rng(0), 20_000, two_sided=True) == pytest.approx(1 / 3, abs=0.01)
    # within strata: (1/6)^2 of the splits of two tasks
    assert permutation_p(2 * pairs, np.random.default_rng(0), 20_000) == pytest.approx(1 / 36, abs=0.005)


@pytest.mark.parametrize("wanted", [0.05, 0.5, 0.9])
def test_power_is_that_of_a_normal_test(monkeypatch, wanted):
    """It is passed where difference + margin > 1.645 standard errors; new runs scatter by one standard error."""
    monkeypatch.setattr("studies.disturbance.claims.POWER_SAMPLES", 1000)
    claim, runs = next(each for each in CLAIMS if each.margin), stats.norm.ppf((np.arange(400) + 0.5) / 400)
    error = np.sqrt(2 * runs.var(ddof=1) / len(runs))
    effect = (1.645 + stats.norm.ppf(wanted)) * error - claim.margin
    assert power([(runs + effect, runs)], claim, np.random.default_rng(0)) == pytest.approx(wanted, abs=0.03)


def test_what_is_larger_in_every_run_is_supported():
    life = {("geometric", NOISE): 0.9, ("geometric", PUSHES): 0.8}
    assert decisions(fresh_runs(life, 1.2)) == ["supported"] * 5


def test_the_first_claim_that_fails_ends_the_decisions():
    life = {("geometric", NOISE): 0.9, ("geometric", PUSHES): 0.5}
    assert decisions(fresh_runs(life)) == ["supported", "not shown", "not tested", "not tested", "not tested"]


def test_a_run_that_stands_does_not_win():
    life = {("geometric", NOISE): 1.0}
    table = claims_table(fresh_runs(life, 0.24))
    assert table.filter(claim=1, task="A")["left mean"].to_list() == [0.0]


def test_missing_runs_are_named_and_decide_nothing():
    frame = fresh_runs({("geometric", NOISE): 0.9}).filter((pl.col("task") != "C") | (pl.col("train_seed") < 15))
    assert decisions(frame)[0] == "runs are missing"
    one_claim = (pl.col("task") != "C") | (pl.col("method") != "geometric-discounted")  # the third lacks a side
    life = {("geometric", NOISE): 0.9, ("geometric", PUSHES): 0.8}
    decided = ["supported", "supported", "runs are missing", "not tested", "not tested"]
    assert decisions(fresh_runs(life).filter(one_claim)) == decided


def test_speed_ends_at_the_last_record_before_the_failure():
    key = {"policy": "p", "task": "A", "train_seed": 0, "clock": "none", "disturbance": "none", "eval_seed": 1}
    rows = [{"step": 10, "return": 20.0}, {"step": 20, "return": 30.0}, {"step": 40, "return": 30.0}]
    frame = pl.DataFrame([key | {"failed_step": 25, "test_horizon": 40} | row for row in rows])
    assert speed_while_working(frame).to_list() == [1.5]
